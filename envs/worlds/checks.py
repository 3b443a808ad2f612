"""Check a task's model and the shapes that its methods return.

`env` is an `Environment` that is being built.
"""

from typing import Any

import mujoco
import numpy as np
import torch

from ..errors import MorlaxError
from .trees import base_of


def model(task: Any, compiled: mujoco.MjModel) -> None:
    """Refuse models with state that a reset does not restore."""
    for name, kind in (("nhistory", "delayed actuators or sensors"), ("npluginstate", "plugins")):
        if getattr(compiled, name):
            raise MorlaxError(
                f"{task.__name__}: its model has {kind}, whose state morlax_torch cannot reset: "
                "remove them from the MJCF."
            )
    base_of(compiled, task.base_body)  # raises where there is no such body


def start(env: Any) -> np.ndarray:
    """Return `initial_qpos()` if it has the shape (nq,)."""
    qpos, nq = np.asarray(env.initial_qpos()), env.physics.model.nq
    if qpos.shape != (nq,):
        raise _wrong(env, "initial_qpos()", qpos.shape, f"({nq},), one number per qpos")
    return qpos


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
        env.apply(torch.zeros(N, A, device=env.device))
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
