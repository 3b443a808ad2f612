"""`episodes` in one Warp kernel each, where torch takes a dozen."""

from collections.abc import Sequence

import warp as wp
from torch import Tensor

from .physics import Physics

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _end(
    qpos: wp.array2d(dtype=float),  # (N, nq)
    qvel: wp.array2d(dtype=float),  # (N, nv)
    failed: wp.array(dtype=wp.bool),  # (N,)
    length: int,
    age: wp.array(dtype=int),  # (N,)
    reward: wp.array2d(dtype=float),  # (N, m)
    terminated: wp.array(dtype=wp.bool),  # (N,)
    truncated: wp.array(dtype=wp.bool),  # (N,)
    over: wp.array(dtype=wp.bool),  # (N,)
    blown_up: wp.array(dtype=wp.bool),  # (N,)
    blowups: wp.array(dtype=wp.int64),  # (1,)
):
    world = wp.tid()
    finite = wp.bool(True)
    for i in range(qpos.shape[1]):
        finite = finite and wp.isfinite(qpos[world, i])
    for i in range(qvel.shape[1]):
        finite = finite and wp.isfinite(qvel[world, i])
    if not finite:
        wp.atomic_add(blowups, 0, wp.int64(1))
        for i in range(reward.shape[1]):
            reward[world, i] = 0.0
    older = age[world] + 1
    age[world] = older
    fallen = failed[world] or not finite
    timed_out = older >= length
    blown_up[world] = not finite
    terminated[world] = fallen
    truncated[world] = timed_out and not fallen
    over[world] = fallen or timed_out


@wp.kernel
def _restart(
    over: wp.array(dtype=wp.bool),  # (N,)
    chosen: wp.array(dtype=wp.int64),  # (N,) rows of the starts
    start_qpos: wp.array2d(dtype=float),  # (B, nq)
    start_qvel: wp.array2d(dtype=float),  # (B, nv)
    start_sensors: wp.array2d(dtype=float),  # (B, nsensordata)
    qpos: wp.array2d(dtype=float),  # (N, nq)
    qvel: wp.array2d(dtype=float),  # (N, nv)
    warmstart: wp.array2d(dtype=float),  # (N, nv)
    sensors: wp.array2d(dtype=float),  # (N, nsensordata)
    age: wp.array(dtype=int),  # (N,)
):
    world = wp.tid()
    if over[world]:
        row = int(chosen[world])
        for i in range(qpos.shape[1]):
            qpos[world, i] = start_qpos[row, i]
        for i in range(qvel.shape[1]):
            qvel[world, i] = start_qvel[row, i]
            warmstart[world, i] = 0.0
        for i in range(sensors.shape[1]):
            sensors[world, i] = start_sensors[row, i]
        age[world] = 0


def end(
    physics: Physics,
    failed: Tensor,
    length: int,
    age: Tensor,
    reward: Tensor,
    blowups: Tensor,
    ends: Sequence[Tensor],
) -> None:
    """`episodes.end`, into the fields of `Ends`."""
    before = [physics.qpos, physics.qvel, failed]
    after = [age, reward, *ends, blowups.view(1)]
    _launch(_end, [*map(wp.from_torch, before), length, *map(wp.from_torch, after)])


def restart(physics: Physics, over: Tensor, starts: Sequence[Tensor], age: Tensor) -> None:
    """`episodes.restart`."""
    state = [physics.qpos, physics.qvel, physics.warmstart, physics.sensors]
    _launch(_restart, [*map(wp.from_torch, [over, *starts, *state, age])])


def _launch(kernel: wp.Kernel, inputs: list) -> None:
    wp.launch(kernel, inputs[0].shape[0], inputs, device=inputs[0].device)
