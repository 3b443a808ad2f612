"""Multi-objective robot tasks on MuJoCo Warp and C MuJoCo; knows nothing of learning."""

if __name__ == "envs":
    raise ImportError("import this package as morlax_torch.envs, not as envs.")

from .device import resolve_device
from .errors import MorlaxError
from .physics.interface import Physics
from .registry import get, make, make_robot, names, register
from .trust import check_trusted, trust
from .worlds.environment import Environment
from .worlds.gymnasium import from_gymnasium
from .worlds.interface import TimeStep, Worlds
from .worlds.layout import Part, positions, velocities
from .worlds.options import ObjectiveOptions, Randomization, TaskOptions

__all__ = [
    "Environment",
    "MorlaxError",
    "ObjectiveOptions",
    "Part",
    "Physics",
    "Randomization",
    "TaskOptions",
    "TimeStep",
    "Worlds",
    "check_trusted",
    "from_gymnasium",
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
