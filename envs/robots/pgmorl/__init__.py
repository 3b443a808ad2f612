"""The seven tasks of PG-MORL: "Prediction-Guided Multi-Objective Reinforcement Learning for
Continuous Robot Control", Xu et al., ICML 2020.

Rewards, observations, terminations, frame skips and episode lengths follow the released code. The
robots are gymnasium's, edited at load where the benchmark's MJCF differs. The released code runs an
older MuJoCo, in which the same actions give similar but not identical motions.
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
