"""Check a task's model, the shapes that its methods return, and what is given to its worlds.

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
        for label, each in ((name, value), *((f"{name}[{key!r}]", each) for key, each in several)):
            if isinstance(each, np.ndarray) and each.dtype.kind in "biuf":
                each = torch.from_numpy(each)
            if isinstance(each, Tensor) and each.ndim and len(each) == env.num_worlds:
                yield label, each.detach()


def rows(env: Any, method: str, letter: str) -> int:
    """Return the width of the rows (N, width) that `method` returns, or 0 for None."""
    values, N = getattr(env, method)(), env.num_worlds
    if values is None:
        return 0
    if _shape(values)[:1] != (N,) or values.ndim != 2:
        raise _wrong(env, f"{method}()", _shape(values), f"({N}, {letter}), one row per world")
    return values.shape[1]


def sizes(env: Any) -> None:
    """Refuse robots that cannot act, policies that would see nothing, and a wrong `layout()`."""
    task = type(env).__name__
    if env.action_size < 1 and not env.physics.model.nu:
        raise MorlaxError(
            f"the model of {task} has no actuators, as from a URDF: add an <actuator> section to "
            "the MJCF, or motors with spec.add_actuator of mujoco.MjSpec in load_model."
        )
    for what, size in (("count_actions()", env.action_size), ("observe()", env.observation_size)):
        if size < 1:
            raise MorlaxError(f"{task}.{what} gives {size} numbers: it must be at least one.")
    named = sum(part.size for part in env.layout())
    if named != env.observation_size:
        raise MorlaxError(
            f"{task}: layout() names {named} numbers, but observe() gives {env.observation_size}: "
            "they must agree."
        )


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


def rewards(env: Any) -> None:
    """Check that `terms()` returns (N,) by name and `failed()` (N,) bool."""
    N = env.num_worlds
    for name, term in env.terms().items():
        if _shape(term) != (N,):
            raise _wrong(env, f"terms()[{name!r}]", _shape(term), f"({N},), one number per world")
    failed = env.failed()
    if _shape(failed) != (N,) or failed.dtype != torch.bool:
        kind = f"{_shape(failed)} of {getattr(failed, 'dtype', type(failed).__name__)}"
        raise _wrong(env, "failed()", kind, f"({N},) of torch.bool, one answer per world")


def action(worlds: Any, values: Any) -> None:
    """Raise MorlaxError unless `values` is (N, A), of floating point, on the device of `worlds`."""
    if not isinstance(values, Tensor):
        raise MorlaxError(f"step needs actions as a torch.Tensor, not {type(values).__name__}.")
    shape, device = (worlds.num_worlds, worlds.action_size), worlds.device.type
    if values.shape != shape or not values.is_floating_point() or values.device.type != device:
        raise MorlaxError(
            f"step needs actions of shape {shape} and a floating-point type on {device}, "
            f"not {tuple(values.shape)} of {values.dtype} on {values.device.type}."
        )


def mask(worlds: Any, which: Any) -> None:
    """Raise MorlaxError unless `which` is (N,) bool, one answer for each world."""
    kind = getattr(which, "dtype", type(which).__name__)
    if kind != torch.bool or which.shape != (worlds.num_worlds,):
        raise MorlaxError(
            f"restart needs a mask of shape ({worlds.num_worlds},) and torch.bool, one answer for "
            f"each world, not {_shape(which)} of {kind}."
        )


def _shape(value: object) -> tuple[int, ...]:
    return tuple(getattr(value, "shape", ()))


def _wrong(env: Any, what: str, shape: object, expected: str) -> MorlaxError:
    return MorlaxError(f"{type(env).__name__}.{what} has shape {shape}: it must be {expected}.")
