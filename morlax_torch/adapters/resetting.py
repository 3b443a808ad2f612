"""Handle the arguments of `reset` for the Gymnasium environments."""

from typing import Any

import numpy as np

from ..envs import MorlaxError, Worlds


def prepare(
    worlds: Worlds,
    random: np.random.Generator,
    options: dict[str, Any] | None,
    draw: bool,
) -> None:
    """Reject options, and reseed the worlds if `draw`.

    Args:
        worlds: reseeded in place.
        random: the environment's generator, which draws the seed of the worlds.
        options: as passed to `reset`; none are supported.
        draw: whether to reseed.

    Raises:
        MorlaxError: `options` is not empty.
    """
    if options:
        raise MorlaxError(
            f"reset takes no options, but got {', '.join(map(repr, options))}: leave them out."
        )
    if draw:
        worlds.reseed(int(random.integers(2**63)))
