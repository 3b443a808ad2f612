"""The MuJoCo tasks of MO-Gymnasium, version 5: "A Toolkit for Reliable Benchmarking and Research
in Multi-Objective Reinforcement Learning", Felten et al., NeurIPS 2023.

Rewards, observations, terminations, frame skips, episode lengths and reset noise match the
originals. The reference points are our choice: -100 per objective, and for control minus the
largest possible cost of an episode. mo-reacher-v5 is missing because its actions are discrete.
"""

from .ant import Ant, Ant2
from .halfcheetah import HalfCheetah
from .hopper import Hopper, Hopper2
from .humanoid import Humanoid
from .swimmer import Swimmer
from .walker2d import Walker2d

TASKS = {
    "mo-gymnasium/ant": Ant,
    "mo-gymnasium/ant-2obj": Ant2,
    "mo-gymnasium/halfcheetah": HalfCheetah,
    "mo-gymnasium/hopper": Hopper,
    "mo-gymnasium/hopper-2obj": Hopper2,
    "mo-gymnasium/humanoid": Humanoid,
    "mo-gymnasium/swimmer": Swimmer,
    "mo-gymnasium/walker2d": Walker2d,
}
