"""Multi-objective robot tasks on MuJoCo Warp and C MuJoCo; knows nothing of learning.

torch and the simulators are imported with the first name that needs them.
"""

if __name__ == "envs":
    raise ImportError("import this package as morlax_torch.envs, not as envs.")

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .errors import MorlaxError
from .naming import check_trusted, trust
from .worlds.options import ObjectiveOptions, Randomization, TaskOptions

if TYPE_CHECKING:
    from .bridges.gymnasium import from_gymnasium
    from .bridges.vecenv import from_vecenv
    from .devices import resolve_device
    from .making import make, make_robot
    from .physics.interface import Physics
    from .registry import get, names, register
    from .worlds.design_space import DesignParameter
    from .worlds.environment import Environment
    from .worlds.interface import TimeStep, Worlds
    from .worlds.mujoco_robot import Part, Robot, positions, velocities

_HOMES = {  # of the names above
    "bridges.gymnasium": ("from_gymnasium",),
    "bridges.vecenv": ("from_vecenv",),
    "devices": ("resolve_device",),
    "making": ("make", "make_robot"),
    "physics.interface": ("Physics",),
    "registry": ("get", "names", "register"),
    "worlds.design_space": ("DesignParameter",),
    "worlds.environment": ("Environment",),
    "worlds.interface": ("TimeStep", "Worlds"),
    "worlds.mujoco_robot": ("Part", "Robot", "positions", "velocities"),
}
_LATE = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _LATE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f".{_LATE[name]}", __name__), name)
    globals()[name] = value  # so that this is called once for each name
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_LATE})


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
