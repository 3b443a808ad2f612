"""Independent policies: plain PPO for each of a fixed set of trade-offs."""

from typing import Any

from ..configuration.config import Config
from ..configuration.tradeoffs import even_tradeoffs
from ..envs import Worlds
from .morlax import MORLAX


class IndependentPPO(MORLAX):
    """Trains K policies that share no parameters, each for one of K evenly spread trade-offs.

    Each is plain PPO (Schulman et al., 2017) in its own worlds, with its own advantages, gradient
    norm and moments of Adam; only the normalizers of observations and values see all worlds. With
    enough steps it is the reference that fronts are measured against.

    Args:
        env: the worlds.
        config: with `network.type: independent` and sparse sampling.
        others: as of `MORLAX`.
    """

    def __init__(self, env: Worlds, config: Config, **others: Any):
        super().__init__(env, config, **others)
        self.tradeoffs.copy_(even_tradeoffs(*self.tradeoffs.shape))

    def draw_tradeoffs(self) -> None:
        """Keep those of the start."""
