"""The seven tasks of PG-MORL: "Prediction-Guided Multi-Objective Reinforcement Learning for
Continuous Robot Control", Xu et al., ICML 2020.

Rewards, observations, ends of episodes, frame skips and lengths are those of its released code,
and so are the robots: gymnasium's, changed at load where that benchmark's own MJCF differs. Its
code drives an older MuJoCo, in which equal actions move a robot alike, but not equally.
"""

from .ant import Ant
from .halfcheetah import HalfCheetah
from .hopper import Hopper, Hopper3
from .humanoid import Humanoid
from .swimmer import Swimmer
from .walker2d import Walker2d

TASKS = {
    "pgmorl/ant": Ant,
    "pgmorl/halfcheetah": HalfCheetah,
    "pgmorl/hopper": Hopper,
    "pgmorl/hopper3": Hopper3,
    "pgmorl/humanoid": Humanoid,
    "pgmorl/swimmer": Swimmer,
    "pgmorl/walker2d": Walker2d,
}
