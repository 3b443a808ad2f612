"""The built-in tasks, by name."""

from ..worlds.interface import Worlds
from . import mo_gymnasium, pgmorl
from .ant import Ant
from .bruce import Bruce
from .cheetah import Cheetah, Cheetah3
from .hopper import Hopper
from .humanoid import Humanoid
from .walker import Walker

TASKS: dict[str, type[Worlds]] = {
    "ant": Ant,
    "bruce": Bruce,
    "cheetah": Cheetah,
    "cheetah3": Cheetah3,
    "hopper": Hopper,
    "humanoid": Humanoid,
    "walker": Walker,
    **pgmorl.TASKS,
    **mo_gymnasium.TASKS,
}
