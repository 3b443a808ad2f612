"""The MuJoCo tasks of MO-Gymnasium, version 5: "A Toolkit for Reliable Benchmarking and Research
in Multi-Objective Reinforcement Learning", Felten et al., NeurIPS 2023.

Rewards, observations, terminations, frame skips, episode lengths and the size of the reset noise
match the originals; docs/tasks.md lists what differs. The reference points are our choice: -100 per
objective, and for control minus the largest possible cost of an episode. mo-reacher-v5 is missing
because its actions are discrete.
"""

TASKS = {
    "mo-gymnasium/ant": "mo_gymnasium.ant:Ant",
    "mo-gymnasium/ant-2obj": "mo_gymnasium.ant:Ant2",
    "mo-gymnasium/halfcheetah": "mo_gymnasium.halfcheetah:HalfCheetah",
    "mo-gymnasium/hopper": "mo_gymnasium.hopper:Hopper",
    "mo-gymnasium/hopper-2obj": "mo_gymnasium.hopper:Hopper2",
    "mo-gymnasium/humanoid": "mo_gymnasium.humanoid:Humanoid",
    "mo-gymnasium/swimmer": "mo_gymnasium.swimmer:Swimmer",
    "mo-gymnasium/walker2d": "mo_gymnasium.walker2d:Walker2d",
}
