"""The end of episodes and the start of new ones, as torch definitions."""

from collections.abc import Sequence
from typing import NamedTuple

from torch import Tensor

from ..device import kernel
from ..physics.interface import Physics

MAX_POSITION = 1e5  # m, rad
MAX_VELOCITY = 1e4  # m/s, rad/s


class Ends(NamedTuple):
    """How a control step left N worlds."""

    terminated: Tensor  # (N,) bool: failed or blown up
    truncated: Tensor  # (N,) bool: time ran out
    over: Tensor  # (N,) bool: terminated or truncated
    blown_up: Tensor  # (N,) bool: no longer within sane bounds


def on_cuda(physics: Physics, *_: object) -> bool:
    return physics.device.type == "cuda"


@kernel(f"{__package__}.episode_kernels.end", on_cuda)
def end(
    physics: Physics,
    action: Tensor,
    observation: Tensor,
    failed: Tensor,
    length: int,
    age: Tensor,
    reward: Tensor,
    terms: Tensor,
    blowups: Tensor,
) -> Ends:
    """Decide which episodes end with the last control step.

    A world has blown up if a number of its action, observation or reward is not finite, or if its
    state exceeds MAX_POSITION or MAX_VELOCITY. MuJoCo itself warns only above 1e10, but a reward
    of such a size already ruins every running mean.

    Args:
        physics: after the step.
        action: (N, A) the action of the step.
        observation: (N, O + P) the observation after the step.
        failed: (N,) bool, the robot's own verdict.
        length: control steps after which an episode is truncated.
        age: (N,) int32 steps of the episode, incremented in place.
        reward: (N, m), set to zero in place where a world blew up.
        terms: (N, terms), likewise.
        blowups: () int64, incremented in place by the number of blown-up worlds.
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


@kernel(f"{__package__}.episode_kernels.restart", on_cuda)
def restart(physics: Physics, over: Tensor, starts: Sequence[Tensor], age: Tensor) -> None:
    """Put the worlds that are `over` (N,) bool into the states of `Starts.draw`, at age zero."""
    done = over.nonzero().squeeze(-1)
    rows, qpos, qvel, sensors = starts
    rows = rows[done]
    physics.qpos[done] = qpos[rows]
    physics.qvel[done] = qvel[rows]
    physics.act[done] = 0.0
    physics.sensors[done] = sensors[rows]
    physics.warmstart[done] = 0.0
    age[done] = 0
