"""The ends of episodes and their new beginnings.

The torch definitions serve the CPU; on CUDA `fused` does the same.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from . import fused
from .physics import Physics


class Ends(NamedTuple):
    """How a control step left N worlds."""

    terminated: Tensor  # (N,) bool: failed, or blown up
    truncated: Tensor  # (N,) bool: time ran out
    over: Tensor  # (N,) bool: one or the other
    blown_up: Tensor  # (N,) bool: the state is no longer finite


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
        ends = Ends(*(torch.empty_like(failed) for _ in Ends._fields))
        fused.end(physics, failed, length, age, reward, blowups, ends)
        return ends
    blown_up = ~(physics.qpos.isfinite().all(-1) & physics.qvel.isfinite().all(-1))
    blowups += blown_up.sum()
    reward.masked_fill_(blown_up[:, None], 0.0)
    age += 1
    terminated, timed_out = failed | blown_up, age >= length
    return Ends(terminated, timed_out & ~terminated, terminated | timed_out, blown_up)


def restart(physics: Physics, over: Tensor, starts: Sequence[Tensor], age: Tensor) -> None:
    """Put the worlds that are `over` (N,) into what `Starts.draw` gave, at age zero."""
    if physics.device.type == "cuda":
        fused.restart(physics, over, starts, age)
        return
    done = over.nonzero().squeeze(-1)
    rows, qpos, qvel, sensors = starts
    rows = rows[done]
    physics.qpos[done] = qpos[rows]
    physics.qvel[done] = qvel[rows]
    physics.sensors[done] = sensors[rows]
    physics.warmstart[done] = 0.0
    age[done] = 0
