"""What the methods of a task give has the shape that it must have, or one sentence says so."""

from typing import TYPE_CHECKING

import numpy as np
import torch

from .errors import MorlaxError

if TYPE_CHECKING:
    from .environment import Environment


def start(env: "Environment") -> np.ndarray:
    """`initial_qpos()`, (nq,)."""
    qpos, nq = np.asarray(env.initial_qpos()), env.physics.model.nq
    if qpos.shape != (nq,):
        raise _wrong(env, "initial_qpos()", qpos.shape, f"({nq},), a number for each of qpos")
    return qpos


def rows(env: "Environment", method: str, letter: str) -> int:
    """The width of what `method` gives, (N, width) with a row for each world."""
    given, N = getattr(env, method)(), env.num_worlds
    if given is None:
        return 0
    if _shape(given)[:1] != (N,) or given.ndim != 2:
        expected = f"({N}, {letter}), a row for each world"
        raise _wrong(env, f"{method}()", _shape(given), expected)
    return given.shape[1]


def layout(env: "Environment") -> None:
    """`layout()` tells of as many numbers as `observe()` gives."""
    named = sum(part.size for part in env.layout())
    if named != env.observation_size:
        raise MorlaxError(
            f"{type(env).__name__}: layout() names {named} numbers, but observe() gives "
            f"{env.observation_size}: let both tell of the same ones."
        )


def rewards(env: "Environment") -> None:
    """`terms()` gives (N,) by name, and `failed()` (N,) bool."""
    expected = f"({env.num_worlds},), a number for each world"
    for name, term in env.terms().items():
        if _shape(term) != (env.num_worlds,):
            raise _wrong(env, f"terms()[{name!r}]", _shape(term), expected)
    failed = env.failed()
    if _shape(failed) != (env.num_worlds,) or failed.dtype != torch.bool:
        kind = getattr(failed, "dtype", type(failed).__name__)
        expected = f"({env.num_worlds},) of torch.bool, an answer for each world"
        raise _wrong(env, "failed()", f"{_shape(failed)} of {kind}", expected)


def control(env: "Environment") -> None:
    """`apply()` writes actions (N, A) into `physics.ctrl`, which is put back as it was."""
    ctrl, N, A = env.physics.ctrl, env.num_worlds, env.action_size
    before = ctrl.clone()
    try:
        env.apply(torch.zeros(N, A, device=env.device))
    except RuntimeError as error:
        raise MorlaxError(
            f"{type(env).__name__}.apply() does not get from an action of shape {(N, A)} to "
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


def _wrong(env: "Environment", what: str, given: object, expected: str) -> MorlaxError:
    return MorlaxError(f"{type(env).__name__}.{what} has shape {given}: it must be {expected}.")
