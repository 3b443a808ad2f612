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

_HOMES = {
    "DesignParameter": "worlds.design_space",
    "Environment": "worlds.environment",
    "Part": "worlds.mujoco_robot",
    "Physics": "physics.interface",
    "Robot": "worlds.mujoco_robot",
    "TimeStep": "worlds.interface",
    "Worlds": "worlds.interface",
    "from_gymnasium": "bridges.gymnasium",
    "from_vecenv": "bridges.vecenv",
    "get": "registry",
    "make": "making",
    "make_robot": "making",
    "names": "registry",
    "positions": "worlds.mujoco_robot",
    "register": "registry",
    "resolve_device": "devices",
    "velocities": "worlds.mujoco_robot",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f".{_HOMES[name]}", __name__), name)
    globals()[name] = value  # so that this is called once for each name
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})


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
