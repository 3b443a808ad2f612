"""Metrics of learners, read from the GPU at once."""

from torch import Tensor, stack

from ..envs import Worlds
from ..gpu.group import Group
from .rollout import Episodes


def read(
    parts: dict[str, Tensor], env: Worlds, episodes: Episodes, group: Group
) -> dict[str, float]:
    """Return means over all processes, with blow-ups, overflows and the returns of episodes.

    Waits for the GPU, and for the other processes. Returns and lengths are means of the episodes
    that have ended, if any have.

    Args:
        parts: a number () each.
        env: this process's worlds.
        episodes: their episodes.
        group: the processes.
    """
    names = [*(f"episode_return/{name}" for name in env.objectives), "episode_length"]
    own = {**parts, "blowups": env.blowups.float()}
    means = group.mean_(stack([*own.values(), *episodes.totals]))
    overflow = group.largest_(env.overflow().max().float()[None])
    *values, largest = [*means.tolist(), *overflow.tolist()]
    found = dict(zip(own, values, strict=False))
    found["blowups"] *= group.size
    *totals, number = values[len(own) :]
    if number:
        found |= {name: total / number for name, total in zip(names, totals, strict=True)}
    return {**found, "overflow": largest}
