"""The ends of episodes and their new beginnings.

On CUDA each is one Warp kernel, where torch, whose definitions serve the CPU, takes a dozen.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
import warp as wp
from torch import Tensor

from .physics import Physics

wp.set_module_options({"enable_backward": False})


class Ends(NamedTuple):
    """How a control step left N worlds."""

    terminated: Tensor  # (N,) bool: failed, or blown up
    truncated: Tensor  # (N,) bool: time ran out
    blown_up: Tensor  # (N,) bool: the state is no longer finite


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
    over = failed[world] or not finite
    blown_up[world] = not finite
    terminated[world] = over
    truncated[world] = older >= length and not over


@wp.kernel
def _restart(
    terminated: wp.array(dtype=wp.bool),  # (N,)
    truncated: wp.array(dtype=wp.bool),  # (N,)
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
    if terminated[world] or truncated[world]:
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
    physics: Physics, failed: Tensor, length: int, age: Tensor, reward: Tensor, blowups: Tensor
) -> Ends:
    """Judge the step that N worlds just made.

    Args:
        failed: (N,) bool: what the robot itself says.
        length: control steps after which an episode is truncated.
        age: (N,) int32 steps of the episode, counted on in place.
        reward: (N, m), set to zero in place where a world blew up.
        blowups: () int64, counted on in place.
    """
    if physics.device.type == "cuda":
        return end_fused(physics, failed, length, age, reward, blowups)
    blown_up = ~(physics.qpos.isfinite().all(-1) & physics.qvel.isfinite().all(-1))
    blowups += blown_up.sum()
    reward.masked_fill_(blown_up[:, None], 0.0)
    age += 1
    terminated = failed | blown_up
    return Ends(terminated, (age >= length) & ~terminated, blown_up)


def end_fused(
    physics: Physics, failed: Tensor, length: int, age: Tensor, reward: Tensor, blowups: Tensor
) -> Ends:
    """`end` in one kernel."""
    ends = Ends(*(torch.empty_like(failed) for _ in Ends._fields))
    before = [physics.qpos, physics.qvel, failed]
    after = [age, reward, *ends, blowups.view(1)]
    _launch(_end, [*map(wp.from_torch, before), length, *map(wp.from_torch, after)])
    return ends


def restart(
    physics: Physics, terminated: Tensor, truncated: Tensor, starts: Sequence[Tensor], age: Tensor
) -> None:
    """Put the worlds whose episode is over into what `Starts.draw` gave, at age zero."""
    if physics.device.type == "cuda":
        restart_fused(physics, terminated, truncated, starts, age)
        return
    done = (terminated | truncated).nonzero().squeeze(-1)
    rows, qpos, qvel, sensors = starts
    rows = rows[done]
    physics.qpos[done] = qpos[rows]
    physics.qvel[done] = qvel[rows]
    physics.sensors[done] = sensors[rows]
    physics.warmstart[done] = 0.0
    age[done] = 0


def restart_fused(
    physics: Physics, terminated: Tensor, truncated: Tensor, starts: Sequence[Tensor], age: Tensor
) -> None:
    """`restart` in one kernel."""
    state = [physics.qpos, physics.qvel, physics.warmstart, physics.sensors]
    _launch(_restart, [*map(wp.from_torch, [terminated, truncated, *starts, *state, age])])


def _launch(kernel: wp.Kernel, inputs: list) -> None:
    wp.launch(kernel, inputs[0].shape[0], inputs, device=inputs[0].device)
