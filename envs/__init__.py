"""Multi-objective robot tasks on MuJoCo Warp and C MuJoCo; knows nothing of learning.

torch and the simulators are imported with the first name that needs them.
"""

if __name__ == "envs":
    raise ImportError("import this package as morlax_torch.envs, not as envs.")

from typing import TYPE_CHECKING

from .errors import MorlaxError
from .lazy import handed_on
from .naming import check_trusted, trust
from .worlds.options import ObjectiveOptions, Randomization, TaskOptions

if TYPE_CHECKING:
    from .bridges.gymnasium import from_gymnasium
    from .bridges.vecenv import from_vecenv
    from .devices import resolve_device
    from .making import make, make_robot
    from .physics.interface import Physics
    from .registry import get, names, register
    from .worlds.designs import DesignParameter
    from .worlds.environment import Environment
    from .worlds.interface import TimeStep, Worlds
    from .worlds.robot import Part, Robot, positions, velocities

__getattr__, __dir__ = handed_on(
    __name__,
    {
        "DesignParameter": "worlds.designs",
        "Environment": "worlds.environment",
        "Part": "worlds.robot",
        "Physics": "physics.interface",
        "Robot": "worlds.robot",
        "TimeStep": "worlds.interface",
        "Worlds": "worlds.interface",
        "from_gymnasium": "bridges.gymnasium",
        "from_vecenv": "bridges.vecenv",
        "get": "registry",
        "make": "making",
        "make_robot": "making",
        "names": "registry",
        "positions": "worlds.robot",
        "register": "registry",
        "resolve_device": "devices",
        "velocities": "worlds.robot",
    },
)

__all__ = [
    "DesignParameter",
    "Environment",
    "MorlaxError",
    "ObjectiveOptions",
    "Part",
    "Physics",
    "Randomization",
    "Robot",
    "TaskOptions",
    "TimeStep",
    "Worlds",
    "check_trusted",
    "from_gymnasium",
    "from_vecenv",
    "get",
    "make",
    "make_robot",
    "names",
    "positions",
    "register",
    "resolve_device",
    "trust",
    "velocities",
]
