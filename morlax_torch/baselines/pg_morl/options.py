"""Options of PG-MORL."""

from typing import Annotated, Any, ClassVar

from pydantic import Field, NonNegativeFloat

from ...configuration.sections import MethodOptions
from ...envs.worlds.options import Count


class PGMORLOptions(MethodOptions):
    """Options of PG-MORL."""

    required: ClassVar[dict[str, Any]] = {
        "network.type": "independent",
        "sampling.mode": "sparse",
        "sampling.corners": 0,
        "ppo.optimizer": "separate",
    }
    weighted_sums: ClassVar[bool] = True
    generation: Count | None = None
    """Iterations between two selections of what to train (None: at least 20, and so many that
    measuring the policies takes at most about 8 % of the time)."""
    warmup: Count = 80
    """Iterations for which each policy keeps its trade-off of an even grid."""
    bins: Annotated[int, Field(ge=1, le=10_000)] = 100
    """Directions of the objective space in which policies are kept."""
    bin_size: Annotated[int, Field(ge=1, le=100)] = 2
    """Number of policies kept per direction."""
    candidates: Annotated[int, Field(ge=2, le=1000)] = 7
    """Trade-offs considered for each of the kept policies."""
    sparsity: NonNegativeFloat = 1.0
    """Weight of the front's sparsity, beside its hypervolume, in the selection."""

    @property
    def num_networks(self) -> int:
        """R, the size of the archive."""
        return self.bins * self.bin_size

    def agent_class(self) -> Any:
        from .agent import PopulationAgent

        return PopulationAgent


OPTIONS = PGMORLOptions
