"""Check a task's model, the shapes of its methods' results, actions and masks.

`env` is an `Environment` that is being built.
"""

import sys
from collections.abc import Iterable, Iterator
from operator import attrgetter
from typing import Any, Self

import mujoco
import numpy as np
import torch
from torch import Tensor

from ..errors import MorlaxError, user_code, warn_user
from ..physics.mujoco import MODEL_FIELDS
from .trees import base_of


def model(task: Any, compiled: mujoco.MjModel) -> None:
    """Refuse `substeps` that are no positive integer, and state that a reset does not restore."""
    if not isinstance(compiled, mujoco.MjModel):  # such as None, or an MjSpec
        kind = type(compiled).__name__
        raise MorlaxError(f"{task.__name__}.load_model() returns a {kind}, not a mujoco.MjModel.")
    if not isinstance(task.substeps, int | np.integer) or task.substeps < 1:
        raise MorlaxError(
            f"{task.__name__}.substeps is {task.substeps}: it must be a whole number, at least 1."
        )
    if compiled.npluginstate or compiled.opt.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP:
        cause = "has plugins with a state" if compiled.npluginstate else "lets bodies sleep"
        raise MorlaxError(
            f"{task.__name__}: its model {cause}, which morlax_torch cannot reset: remove this "
            "from the MJCF."
        )
    base_of(compiled, task.base_body)  # raises where there is no such body


def start(env: Any) -> np.ndarray:
    """Return `initial_qpos()` if it has the shape (nq,) and is finite."""
    qpos, nq = np.asarray(answer(env, "initial_qpos")), env.physics.model.nq
    if qpos.shape != (nq,) or not np.isfinite(qpos).all():
        raise _wrong(env, "initial_qpos()", qpos, f"({nq},), one finite number per qpos")
    return qpos


def state(env: Any) -> dict[str, Tensor]:
    """Return the command and `initial_state()`, if these are tensors (N, ...)."""
    tensors, N, limits = by_name(env, "initial_state"), env.num_worlds, len(env.command_limits)
    # rows of an expanded tensor share their memory
    tensors = {name: x.clone() if 0 in x.stride() else x for name, x in tensors.items()}
    try:
        pairs = [(low, high) for low, high in env.command_limits.values()]
        plain = all(isinstance(number, int | float) for pair in pairs for number in pair)
        ordered = plain and all(low < high for low, high in pairs)
    except (AttributeError, TypeError, ValueError):
        ordered = False
    if not ordered:
        example, task = {"m/s forward": (-1.0, 1.0)}, type(env).__name__
        raise MorlaxError(
            f"{task}.command_limits must have the lowest and the highest value of each number by "
            f"name, such as {example}, not {env.command_limits}."
        )
    command: Any = tensors.get("command", getattr(env, "command", None))
    if limits and (_shape(command) != (N, limits) or not command.is_floating_point()):
        expected = f"a tensor ({N}, {limits}) of floats, as in command_limits"
        raise _wrong(env, "command", command, expected)
    if _shape(command)[:1] == (N,):
        env.command = tensors["command"] = command
    return State(tensors)


class State(dict[str, Tensor]):
    """Tensors by name that change in place only, because a recorded step keeps their addresses."""

    def __setitem__(self, name: str, value: Tensor) -> None:
        if value is not self.get(name):  # it is after `state["steps"] += 1`
            raise MorlaxError(
                f"state[{name!r}] cannot be replaced: declare it in initial_state(), and write "
                f"into it, state[{name!r}].copy_(...)."
            )

    def update(self, *others: Any, **values: Tensor) -> None:
        for name, value in dict(*others, **values).items():
            self[name] = value

    def __ior__(self, others: Any) -> Self:
        self.update(others)
        return self


def answer(env: Any, method: str, *arguments: Any) -> Any:
    """Return the answer of a method of worlds, or of their class, or say where it fails."""
    task = env if isinstance(env, type) else type(env)
    file = getattr(sys.modules.get(task.__module__), "__file__", None)
    with user_code(f"{task.__name__}.{method}() fails", file):
        return getattr(env, method)(*arguments)


def by_name(env: Any, method: str) -> dict[str, Tensor]:
    """Return the tensors (N, ...) that `method` returns by name, in a new dictionary."""
    values, N = answer(env, method), env.num_worlds
    if not isinstance(values, dict):
        raise _wrong(env, f"{method}()", values, f"a dictionary of tensors ({N}, ...) by name")
    for name, value in values.items():
        if _shape(value)[:1] != (N,):
            what = f"{method}()[{name!r}]"
            raise _wrong(env, what, value, f"a tensor ({N}, ...), one row per world")
    return dict(values)


class Unsaved:
    """Notices attributes with one row per world that change, although no checkpoint has them."""

    def __init__(self, env: Any):
        self._env, self._warned = env, set[str]()
        self._former = {name: value.clone() for name, value in _attributes(env)}

    def warn(self, saved: Iterable[Tensor]) -> None:
        """Warn, once of each, of tensors that have changed and share no memory with those saved."""
        memory = {value.untyped_storage().data_ptr() for value in saved}
        new = [
            name
            for name, value in _attributes(self._env)
            if not torch.equal(value, self._former.setdefault(name, value.clone()))
            and value.untyped_storage().data_ptr() not in memory
            and name not in self._warned
        ]
        self._warned.update(new)
        if new:
            warn_user(
                f"{type(self._env).__name__} changes {', '.join(new)}, with one row per world, "
                "which no checkpoint saves, so a resumed run will differ: declare such tensors in "
                "initial_state() (docs/your-own-robot.md)."
            )


def _attributes(env: Any) -> Iterator[tuple[str, Tensor]]:
    """Return the attributes (N, ...), also of dictionaries and lists, with their names."""
    for name, value in vars(env).items():
        values = dict(enumerate(value)) if isinstance(value, list | tuple) else value
        parts = {name: value}
        if isinstance(values, dict):
            parts = {f"{name}[{key!r}]": part for key, part in values.items()}
        for label, part in parts.items():
            if isinstance(part, np.ndarray) and part.dtype.kind in "biuf":
                part = torch.from_numpy(part)
            if isinstance(part, Tensor) and part.ndim and len(part) == env.num_worlds:
                yield label, part.detach()


def rows(env: Any, method: str, letter: str) -> int:
    """Return the width of the rows (N, width) that `method` returns, or 0 for None."""
    values, N = answer(env, method), env.num_worlds
    if values is None:
        return 0
    if _shape(values)[:1] != (N,) or values.ndim != 2:
        raise _wrong(env, f"{method}()", values, f"a tensor ({N}, {letter}), one row per world")
    return values.shape[1]


def sizes(env: Any) -> None:
    """Refuse robots that cannot act, policies that would see nothing, and a wrong `layout()`."""
    task = type(env).__name__
    if min(env.action_size, env.observation_size) < 1:
        raise MorlaxError(
            f"{task} needs at least one action and one observed number. A model from a URDF has no "
            "actuators: add an <actuator> section to the MJCF, or motors with spec.add_actuator of "
            "mujoco.MjSpec in load_model."
        )
    named = sum(part.size for part in answer(env, "layout"))
    if named != env.observation_size:
        raise MorlaxError(
            f"{task}: layout() names {named} numbers, but observe() gives {env.observation_size}: "
            "they must agree."
        )


def control(env: Any) -> None:
    """Check that `apply()` writes actions (N, A) into `physics.ctrl`, then restore it."""
    ctrl, shape, task = env.physics.ctrl, (env.num_worlds, env.action_size), type(env).__name__
    before, sizes = ctrl.clone(), f"of shape {shape} into physics.ctrl of shape {_shape(ctrl)}"
    with user_code(f"{task}.apply() cannot turn actions {sizes}"):
        env.apply(torch.zeros(shape, dtype=torch.float32, device=env.device))
    ctrl.copy_(before)


def rewards(env: Any) -> None:
    """Check that `terms()` returns (N,) by name and `failed()` (N,) bool."""
    N, failed = env.num_worlds, answer(env, "failed")
    for name, term in by_name(env, "terms").items():
        if _shape(term) != (N,):
            raise _wrong(env, f"terms()[{name!r}]", term, f"a tensor ({N},), one number per world")
    if _shape(failed) != (N,) or failed.dtype != torch.bool:
        raise _wrong(
            env, "failed()", failed, f"a tensor ({N},) of torch.bool, one answer per world"
        )


def fields(env: Any, seed: int) -> dict[str, np.ndarray]:
    """Return `vary_model()` if it has arrays of the model with a row per world, by name."""
    arrays, task = answer(env, "vary_model", seed), type(env).__name__
    if not isinstance(arrays, dict):
        raise _wrong(env, "vary_model()", arrays, "a dictionary of NumPy arrays by name")
    draws = env.draws.number  # fewer than worlds where evaluations share them
    numbers = range(draws, max(draws, env.num_worlds) + 1)
    for name, values in arrays.items():
        if name not in MODEL_FIELDS:
            raise MorlaxError(f"{task}.vary_model() names {name}, no array of mujoco.MjModel.")
        row = np.shape(attrgetter(name)(env.physics.model))  # also of opt.gravity
        fits = isinstance(values, np.ndarray) and values.ndim and values.shape[1:] == row
        if not fits or len(values) not in numbers:
            expected = f"a NumPy array {(draws, *row)}, one row per world"
            raise _wrong(env, f"vary_model()[{name!r}]", values, expected)
    return arrays


def action(worlds: Any, values: Any) -> None:
    """Refuse `values` that are not actions (N, A) on the device of `worlds`."""
    if not isinstance(values, Tensor):
        raise MorlaxError(f"step needs actions as a torch.Tensor, not {type(values).__name__}.")
    shape, device = (worlds.num_worlds, worlds.action_size), worlds.device.type
    if values.shape != shape or not values.is_floating_point() or values.device.type != device:
        raise MorlaxError(
            f"step needs actions of shape {shape} and a floating-point type on {device}, "
            f"not {tuple(values.shape)} of {values.dtype} on {values.device.type}."
        )


def seen(worlds: Any, observation: Any) -> Any:
    """Return the `observation` of critics, if it is (N, O + P) as `worlds` declare."""
    shape = worlds.num_worlds, worlds.observation_size + worlds.privileged_size
    if _shape(observation) != shape:
        raise _wrong(worlds, "critic_observation()", observation, f"a tensor {shape}, as declared")
    return observation


def time_step(worlds: Any, step: Any) -> None:
    """Refuse a `step` that is no `TimeStep` of the sizes that `worlds` declare."""
    N, O, m = worlds.num_worlds, worlds.observation_size, len(worlds.objectives)
    sizes = {"observation": O, "critic_observation": O + worlds.privileged_size}
    sizes |= {f"final_{name}": size for name, size in sizes.items()} | {"reward": m}
    shapes = {name: (N, size) for name, size in sizes.items()}
    for name, shape in {**shapes, "terminated": (N,), "truncated": (N,)}.items():
        value: Any = getattr(step, name, None)
        dtype = torch.float32 if shape[1:] else torch.bool
        if _shape(value) != shape or value.dtype != dtype:
            expected = f"a tensor {shape} of {dtype}, one row per world"
            raise _wrong(worlds, f"step().{name}", value, expected)


def mask(worlds: Any, which: Any) -> None:
    """Refuse masks that are not (N,) bool, one answer for each world."""
    shape, dtype = (worlds.num_worlds,), getattr(which, "dtype", type(which).__name__)
    if _shape(which) != shape or dtype != torch.bool:
        raise MorlaxError(
            f"restart needs a mask of shape {shape} and torch.bool, one answer for each world, not "
            f"{_shape(which)} of {dtype}."
        )


def _shape(value: object) -> tuple[int, ...]:
    return tuple(value.shape) if isinstance(value, Tensor) else ()


def _wrong(env: Any, what: str, value: object, expected: str) -> MorlaxError:
    shape = tuple(getattr(value, "shape", ()))
    name, kind = f"{type(env).__name__}.{what}", type(value).__name__
    return MorlaxError(f"{name} has type {kind} and shape {shape}: it must be {expected}.")
