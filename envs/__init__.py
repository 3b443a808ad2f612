"""Multi-objective robot tasks on MuJoCo Warp and C MuJoCo. Nothing in here knows of learning."""

from typing import Any

import torch
from pydantic import ValidationError

from . import mo_gymnasium, pgmorl
from .ant import Ant
from .bruce import Bruce
from .cheetah import Cheetah, Cheetah3
from .environment import Environment
from .errors import MorlaxError, explained, unknown
from .gymnasium_ids import announce
from .gymnasium_worlds import PREFIX, GymnasiumWorlds, from_gymnasium, from_id
from .hopper import Hopper
from .humanoid import Humanoid
from .layout import Part
from .options import ObjectiveOptions, Randomization, TaskOptions
from .outside import Task, absolute, checked, from_entry_point, from_file, is_file, offered, title
from .physics import Physics
from .walker import Walker
from .worlds import TimeStep, Worlds

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
    "absolute",
    "from_gymnasium",
    "get",
    "is_file",
    "make",
    "names",
    "register",
    "title",
]

_REGISTRY: dict[str, Task] = {}


def register(name: str, environment: Task) -> None:
    """Make `environment` known as `name`, to `make`, to every command and to Gymnasium.

    Raises:
        MorlaxError: the name is taken by another class, or something is missing in this one.
    """
    if name not in _REGISTRY:
        _REGISTRY[name] = checked(environment)
        announce(name)
    elif _REGISTRY[name] is not environment:
        raise MorlaxError(f"there is already an environment called {name!r}: choose another name.")


def names() -> tuple[str, ...]:
    """Every registered name, and what installed packages offer, which stays unloaded."""
    return tuple(sorted({*_REGISTRY, *offered()}))


def get(name: str) -> Task:
    """The class registered as `name`, that of "FILE.py:CLASS" or that of "gymnasium:ID"."""
    if name.startswith(PREFIX):
        return from_id(name)
    if is_file(name):
        return from_file(name)
    if name not in _REGISTRY:
        if name not in offered():
            raise unknown("environment", name, names())
        register(name, from_entry_point(name))
    return _REGISTRY[name]


def make(
    name: str,
    num_worlds: int,
    device: str | torch.device | None = None,
    backend: str | None = None,
    seed: int = 0,
    *,
    auto_reset: bool = True,
    deterministic: bool = False,
    **task_options: object,
) -> Worlds:
    """N worlds of the task `name`.

    Args:
        name: one of `names()`, "FILE.py:CLASS" for a task of your own, or "gymnasium:ID" for any
            environment of Gymnasium's registry that has a vector of rewards.
        num_worlds: N.
        device: "cuda", "cpu", "cuda:1", ...; None is CUDA where there is one.
        backend: "warp" (MuJoCo Warp), "mujoco" (C MuJoCo; CPU only) or None: by the device.
        seed: of whatever the worlds draw at random (the tasks draw nothing unless asked to).
        auto_reset: start a new episode in the step that ended the last one.
        deterministic: let MuJoCo Warp order contacts and constraints alike in every run, at some
            cost in speed; CUDA then repeats itself closely, though not bit for bit.
        task_options: fields of the task's `Options`, for example `episode_length=200`.

    Raises:
        MorlaxError: an unknown name, option or backend, or a device that is not there.
    """
    environment = get(name)
    try:
        options: Any = environment.Options.model_validate(task_options)
    except ValidationError as error:
        raise explained(error, environment.Options) from None
    place = resolve_device(device)
    backend = backend or ("warp" if place.type == "cuda" else "mujoco")
    if num_worlds < 1:
        raise MorlaxError(f"num_worlds is {num_worlds}: it takes at least one world.")
    if issubclass(environment, GymnasiumWorlds):
        if place.type != "cpu" or backend == "warp":
            raise MorlaxError(f"{name} runs on the CPU alone: use --device cpu and no backend.")
        return environment(options, num_worlds, seed, auto_reset)
    model = environment.model_for(options)
    if options.solver_iterations is not None:
        model.opt.iterations = options.solver_iterations
    if backend == "mujoco":
        if place.type != "cpu":
            raise MorlaxError(f"C MuJoCo runs on the CPU: with device {place}, use backend 'warp'.")
        from .mujoco_physics import MujocoPhysics

        physics: Physics = MujocoPhysics(model, num_worlds, environment.substeps)
    elif backend == "warp":
        from .warp_physics import WarpPhysics

        physics = WarpPhysics(
            model,
            num_worlds,
            place,
            environment.substeps,
            options.nconmax,
            options.njmax,
            deterministic,
        )
    else:
        raise unknown("backend", backend, ("mujoco", "warp"))
    return environment(physics, options, seed, auto_reset)


def resolve_device(device: str | torch.device | None) -> torch.device:
    """The device that was asked for, or CUDA where there is one."""
    if device is None:
        device = "cuda" if torch.cuda.is_available() else "cpu"
    try:
        place = torch.device(device)
    except RuntimeError:
        raise MorlaxError(f"{device!r} is no device: say 'cuda', 'cuda:1' or 'cpu'.") from None
    if place.type not in ("cpu", "cuda"):
        raise MorlaxError(f"device {place} is not supported: use 'cuda' or 'cpu'.")
    if place.type == "cuda":
        if not torch.cuda.is_available():
            raise MorlaxError("no CUDA device was found: use --device cpu, or check the driver.")
        place = torch.device("cuda", place.index or 0)
        if place.index >= torch.cuda.device_count():
            raise MorlaxError(f"{place} is not there: there are {torch.cuda.device_count()} GPUs.")
    return place


for _name, _environment in {
    "ant": Ant,
    "bruce": Bruce,
    "cheetah": Cheetah,
    "cheetah3": Cheetah3,
    "hopper": Hopper,
    "humanoid": Humanoid,
    "walker": Walker,
    **pgmorl.TASKS,
    **mo_gymnasium.TASKS,
}.items():
    register(_name, _environment)
