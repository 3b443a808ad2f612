"""What reset means to every environment of Gymnasium's that is made of our worlds."""

from typing import Any

import numpy as np

from ..envs import MorlaxError, Worlds


def prepare(
    worlds: Worlds,
    random: np.random.Generator,
    options: dict[str, Any] | None,
    draw: bool,
) -> None:
    """Refuse options, of which none are known, and let the worlds `draw` from a new seed.

    Raises:
        MorlaxError: there are options.
    """
    if options:
        raise MorlaxError(f"reset knows no options, but got {', '.join(map(repr, options))}.")
    if draw:
        worlds.reseed(int(random.integers(2**63)))
