"""Check a task's model and the shapes that its methods return.

`env` is an `Environment` that is being built.
"""

import warnings
from collections.abc import Iterable, Iterator
from typing import Any

import mujoco
import numpy as np
import torch
from torch import Tensor

from ..errors import MorlaxError, MorlaxWarning
from .trees import base_of


def model(task: Any, compiled: mujoco.MjModel) -> None:
    """Refuse models with state that a reset does not restore."""
    if compiled.npluginstate:
        raise MorlaxError(
            f"{task.__name__}: its model has plugins with a state, which morlax_torch cannot "
            "reset: remove them from the MJCF."
        )
    if compiled.opt.enableflags & getattr(mujoco.mjtEnableBit, "mjENBL_SLEEP", 0):  # since 3.4
        raise MorlaxError(
            f"{task.__name__}: its model lets bodies sleep, which morlax_torch cannot reset: "
            'remove <flag sleep="enable"/> from the MJCF.'
        )
    base_of(compiled, task.base_body)  # raises where there is no such body


def start(env: Any) -> np.ndarray:
    """Return `initial_qpos()` if it has the shape (nq,)."""
    qpos, nq = np.asarray(env.initial_qpos()), env.physics.model.nq
    if qpos.shape != (nq,):
        raise _wrong(env, "initial_qpos()", qpos.shape, f"({nq},), one number per qpos")
    return qpos


def state(env: Any) -> dict[str, Tensor]:
    """Return the command and `initial_state()`, if these are tensors (N, ...) on the device."""
    command, N = getattr(env, "command", None), env.num_worlds
    tensors: dict[str, Any] = {"command": command} if _shape(command)[:1] == (N,) else {}
    device = env.device.type
    for name, value in {**tensors, **env.initial_state()}.items():
        if not isinstance(value, Tensor) or value.shape[:1] != (N,) or value.device.type != device:
            kind = f"{_shape(value)} on {getattr(value, 'device', 'no device')}"
            expected = f"({N}, ...) on {device}, one row per world"
            raise _wrong(env, f"initial_state()[{name!r}]", kind, expected)
        tensors[name] = value
    return tensors


class Unsaved:
    """Notices tensors of a task that change, although no checkpoint has them.

    Tensors are attributes with one row per world, as they are now and whenever worlds are saved.
    """

    def __init__(self, env: Any):
        self._env, self._warned = env, set[str]()
        self._former = {name: value.clone() for name, value in _attributes(env)}

    def warn(self, saved: Iterable[Tensor]) -> None:
        """Warn, once of each, of tensors that have changed and share no memory with those saved."""
        memory = {value.untyped_storage().data_ptr() for value in saved}
        changed = []
        for name, value in _attributes(self._env):
            former = self._former.setdefault(name, value.clone())
            same = value.shape == former.shape and torch.equal(value, former)
            if not same and value.untyped_storage().data_ptr() not in memory:
                changed.append(name)
        new = [name for name in changed if name not in self._warned]
        self._warned.update(new)
        if new:
            warnings.warn(
                f"{type(self._env).__name__} changes {', '.join(new)}, with one row per world, "
                "which no checkpoint saves, so a resumed run will differ: declare such tensors in "
                "initial_state() (docs/your-own-robot.md).",
                MorlaxWarning,
                stacklevel=2,
            )


def _attributes(env: Any) -> Iterator[tuple[str, Tensor]]:
    """Return the attributes (N, ...), also of dictionaries and lists, with their names."""
    for name, value in vars(env).items():
        several = enumerate(value) if isinstance(value, list | tuple) else ()
        several = value.items() if isinstance(value, dict) else several
        for key, each in ((f"{name}[{key!r}]", each) for key, each in several):
            yield from _of_worlds(env, key, each)
        yield from _of_worlds(env, name, value)


def _of_worlds(env: Any, name: str, value: object) -> Iterator[tuple[str, Tensor]]:
    if isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
        value = torch.from_numpy(value)
    if isinstance(value, Tensor) and value.ndim and len(value) == env.num_worlds:
        yield name, value.detach()


def rows(env: Any, method: str, letter: str) -> int:
    """Return the width of the rows (N, width) that `method` returns, or 0 for None."""
    given, N = getattr(env, method)(), env.num_worlds
    if given is None:
        return 0
    if _shape(given)[:1] != (N,) or given.ndim != 2:
        expected = f"({N}, {letter}), one row per world"
        raise _wrong(env, f"{method}()", _shape(given), expected)
    return given.shape[1]


def sizes(env: Any) -> None:
    """Refuse robots that cannot act, and policies that would see nothing."""
    task = type(env).__name__
    if env.action_size < 1 and not env.physics.model.nu:
        raise MorlaxError(
            f"the model of {task} has no actuators, as from a URDF: add an <actuator> section to "
            "the MJCF, or motors with spec.add_actuator of mujoco.MjSpec in load_model."
        )
    for what, size in (("count_actions()", env.action_size), ("observe()", env.observation_size)):
        if size < 1:
            raise MorlaxError(f"{task}.{what} gives {size} numbers: it must be at least one.")


def layout(env: Any) -> None:
    """Check that `layout()` names as many numbers as `observe()` returns."""
    named = sum(part.size for part in env.layout())
    if named != env.observation_size:
        raise MorlaxError(
            f"{type(env).__name__}: layout() names {named} numbers, but observe() gives "
            f"{env.observation_size}: they must agree."
        )


def rewards(env: Any) -> None:
    """Check that `terms()` returns (N,) by name and `failed()` (N,) bool."""
    expected = f"({env.num_worlds},), one number per world"
    for name, term in env.terms().items():
        if _shape(term) != (env.num_worlds,):
            raise _wrong(env, f"terms()[{name!r}]", _shape(term), expected)
    failed = env.failed()
    if _shape(failed) != (env.num_worlds,) or failed.dtype != torch.bool:
        kind = getattr(failed, "dtype", type(failed).__name__)
        expected = f"({env.num_worlds},) of torch.bool, one answer per world"
        raise _wrong(env, "failed()", f"{_shape(failed)} of {kind}", expected)


def control(env: Any) -> None:
    """Check that `apply()` writes actions (N, A) into `physics.ctrl`, then restore it."""
    ctrl, N, A = env.physics.ctrl, env.num_worlds, env.action_size
    before = ctrl.clone()
    try:
        env.apply(torch.zeros(N, A, dtype=torch.float32, device=env.device))
    except RuntimeError as error:
        raise MorlaxError(
            f"{type(env).__name__}.apply() cannot turn actions of shape {(N, A)} into "
            f"physics.ctrl of shape {tuple(ctrl.shape)}: {' '.join(str(error).split())}"
        ) from None
    if env.physics.ctrl is not ctrl:
        raise MorlaxError(
            f"{type(env).__name__}.apply() rebinds physics.ctrl, which detaches it from the "
            "simulator: write into it, physics.ctrl.copy_(...)."
        )
    ctrl.copy_(before)


def _shape(given: object) -> tuple[int, ...]:
    return tuple(getattr(given, "shape", ()))


def _wrong(env: Any, what: str, given: object, expected: str) -> MorlaxError:
    return MorlaxError(f"{type(env).__name__}.{what} has shape {given}: it must be {expected}.")
