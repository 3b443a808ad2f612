"""Episodes: the states that they start from, their end and restart, as torch definitions."""

import copy
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import mujoco
import numpy as np
import torch
from torch import Tensor

from ..devices import Draws
from ..physics.interface import Physics

Array = np.ndarray

NOISY_STARTS = 1024
_EQ = mujoco.mjtEq
LOOPS = [int(kind) for kind in (_EQ.mjEQ_CONNECT, _EQ.mjEQ_WELD, _EQ.mjEQ_JOINT, _EQ.mjEQ_TENDON)]
MOST_CORRECTIONS, CLOSED = 30, 1e-9  # steps of Newton's method, until violations (m, rad) are less
MAX_POSITION = 1e5  # m, rad
MAX_VELOCITY = 1e4  # m/s, rad/s


class Start(NamedTuple):
    """An initial state and its control."""

    qpos: Array  # (nq,)
    qvel: Array  # (nv,)
    ctrl: Array  # (nu,)
    model: mujoco.MjModel | None = None  # of its body; None: that of all worlds


class Starts:
    """B initial states with their sensor readings; B = 1 if every episode starts alike.

    One forward pass here computes the sensor readings, so that no reset needs one. If worlds
    differ in their `bodies`, (N,) int64, `starts` has as many of one after the other.
    """

    def __init__(self, starts: Iterable[Start], physics: Physics, bodies: Tensor | None = None):
        data = mujoco.MjData(physics.model)
        rows, models = [], []
        for qpos, qvel, ctrl, model in starts:
            models.append(model)
            data.qpos[:], data.qvel[:], data.ctrl[:] = qpos, qvel, ctrl
            mujoco.mj_forward(model or physics.model, data)
            rows.append([x.copy() for x in (data.qpos, data.qvel, data.ctrl, data.sensordata)])
        columns = (np.stack(column) for column in zip(*rows, strict=True))
        self.states = [torch.from_numpy(column).to(physics.qpos) for column in columns]
        self.rows = torch.zeros(physics.num_worlds, dtype=torch.int64, device=physics.device)
        self._bodies, self._each = bodies, sum(model is models[0] for model in models)

    def draw(self, draws: Draws) -> list[Tensor]:
        """Draw a row for each world; returns rows (N,), and qpos, qvel, ctrl, sensors (B, ...)."""
        if self._each > 1:
            draws.integers_(self.rows, 0, self._each)
        if self._bodies is not None:
            # Rows of one body follow each other, so row r of body b is b * each + r. Without a new
            # draw (each = 1), `rows` still holds that of the body before: the remainder drops it.
            self.rows.remainder_(self._each).add_(self._bodies, alpha=self._each)
        return [self.rows, *self.states]


def around(
    qpos: Array, noise: float, model: mujoco.MjModel, seed: int, number: int = NOISY_STARTS
) -> Iterable[Start]:
    """Yield one state at rest, with positions (nq,), or with noise `number` states around it.

    The noise is half the width of uniform noise on positions (m, rad) and the standard deviation of
    normal noise on velocities (m/s, rad/s). It leaves loops as closed as the first state has them.
    """
    random = np.random.default_rng(seed)
    closed = np.isin(model.eq_type[model.eq_active0.astype(bool)], LOOPS).any()
    loops = Loops(model, qpos) if noise and closed else None
    for _ in range(number if noise else 1):
        moved, qvel = qpos.copy(), np.zeros(model.nv)
        if noise:
            mujoco.mj_integratePos(model, moved, random.uniform(-noise, noise, model.nv), 1)
            qvel = noise * random.standard_normal(model.nv)
            if loops:
                loops.close(moved, qvel)
        yield Start(moved, qvel, np.zeros(model.nu), model)


class Loops:
    """The equality constraints of a model, as positions (nq,) satisfy or violate them."""

    def __init__(self, model: mujoco.MjModel, qpos: Array):
        self._model = model = copy.copy(model)
        off = mujoco.mjtDisableBit
        model.opt.disableflags |= off.mjDSBL_CONTACT | off.mjDSBL_LIMIT | off.mjDSBL_FRICTIONLOSS
        model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        self._data = mujoco.MjData(model)
        self._offset = self._errors(qpos)[0]

    def close(self, qpos: Array, qvel: Array) -> None:
        """Move a state to the nearest one that violates constraints as the first did, in place."""
        for _ in range(MOST_CORRECTIONS):
            errors, jacobian = self._errors(qpos)
            errors -= self._offset
            if np.abs(errors).max() < CLOSED:
                break
            change = -np.linalg.lstsq(jacobian, errors)[0]
            mujoco.mj_integratePos(self._model, qpos, change, 1)
        qvel -= np.linalg.lstsq(jacobian, jacobian @ qvel)[0]

    def _errors(self, qpos: Array) -> tuple[Array, Array]:
        """Return the violations (ne,) at positions (nq,), and their derivatives (ne, nv)."""
        data = self._data
        data.qpos[:] = qpos
        mujoco.mj_fwdPosition(self._model, data)
        return data.efc_pos.copy(), data.efc_J.reshape(-1, self._model.nv).copy()


class Ends(NamedTuple):
    """How a control step left N worlds."""

    terminated: Tensor  # (N,) bool: failed or blown up
    truncated: Tensor  # (N,) bool: time ran out
    over: Tensor  # (N,) bool: terminated or truncated
    blown_up: Tensor  # (N,) bool: no longer within sane bounds


def end(
    physics: Physics,  # after the step
    action: Tensor,  # (N, A)
    observation: Tensor,  # (N, O + P) after the step
    failed: Tensor,  # (N,) bool, the robot's own verdict
    length: int,  # control steps after which an episode is truncated
    age: Tensor,  # (N,) int32 steps of the episode, incremented in place
    reward: Tensor,  # (N, m), set to zero in place where a world blew up
    terms: Tensor,  # (N, terms), likewise
    blowups: Tensor,  # () int64, incremented in place by the number of blown-up worlds
) -> Ends:
    """Decide which episodes end with the last control step.

    A world has blown up if a number of its action, observation or reward is not finite, or if its
    state exceeds MAX_POSITION or MAX_VELOCITY. MuJoCo itself warns only above 1e10, but a reward
    of such a size already ruins every running mean.
    """
    sane = (physics.qpos.abs() <= MAX_POSITION).all(-1)
    sane &= (physics.qvel.abs() <= MAX_VELOCITY).all(-1)
    for values in (action, observation, reward):
        sane &= values.isfinite().all(-1)
    blown_up = ~sane
    blowups += blown_up.sum()
    reward.masked_fill_(blown_up[:, None], 0.0)
    terms.masked_fill_(blown_up[:, None], 0.0)
    age += 1
    terminated, timed_out = failed | blown_up, age >= length
    return Ends(terminated, timed_out & ~terminated, terminated | timed_out, blown_up)


def restart(physics: Physics, over: Tensor, starts: Sequence[Tensor], age: Tensor) -> None:
    """Put the worlds that are `over` (N,) bool into the states of `Starts.draw`, at age zero."""
    done = over.nonzero().squeeze(-1)
    rows, *states = starts
    targets = physics.qpos, physics.qvel, physics.ctrl, physics.sensors
    for values, state in zip(targets, states, strict=True):
        values[done] = state[rows[done]]
    physics.act[done] = 0.0
    physics.warmstart[done] = 0.0
    age[done] = 0


def refill(fresh: Tensor, initial: Tensor, values: Tensor) -> None:
    """Write `initial` (N, ...), or one (...) for all, into `values` where `fresh` (N,) bool."""
    where = fresh.view(-1, *[1] * (values.ndim - 1))
    torch.where(where, initial, values, out=values)
