"""The seven tasks of PG-MORL: "Prediction-Guided Multi-Objective Reinforcement Learning for
Continuous Robot Control", Xu et al., ICML 2020.

Rewards, observations, terminations, frame skips and episode lengths follow the released code. The
robots are gymnasium's, edited at load where the benchmark's MJCF differs. The released code runs an
older MuJoCo, in which the same actions give similar but not identical motions.
"""

TASKS = {
    "pgmorl/ant": "pgmorl.ant:Ant",
    "pgmorl/halfcheetah": "pgmorl.halfcheetah:HalfCheetah",
    "pgmorl/hopper": "pgmorl.hopper:Hopper",
    "pgmorl/hopper3": "pgmorl.hopper:Hopper3",
    "pgmorl/humanoid": "pgmorl.humanoid:Humanoid",
    "pgmorl/swimmer": "pgmorl.swimmer:Swimmer",
    "pgmorl/walker2d": "pgmorl.walker2d:Walker2d",
}
