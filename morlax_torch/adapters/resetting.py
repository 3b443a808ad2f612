"""Handle the arguments of `reset` for the Gymnasium environments."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..envs import MorlaxError, Worlds
from ..envs.errors import shortened


def one_seed(seeds: Sequence[int], number: int) -> int:
    """Mix the seeds of N worlds into one, because one generator draws for all of them.

    Raises:
        MorlaxError: there are not N seeds, or they are not integers from 0.
    """
    if len(seeds) != number:
        raise MorlaxError(
            f"reset needs one seed, or one for each of the {number} worlds, not {len(seeds)}."
        )
    try:
        return int(np.random.SeedSequence(seeds).generate_state(1, np.uint64)[0])
    except (TypeError, ValueError):
        raise MorlaxError(f"seeds must be integers from 0, not {shortened(seeds)}.") from None


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
