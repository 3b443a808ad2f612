"""Options of PG-MORL."""

from typing import ClassVar

from ...configuration.sections import MethodOptions


class PGMORLOptions(MethodOptions):
    """PG-MORL has no options, but constants."""

    weighted_sums: ClassVar[bool] = True
    agent: ClassVar[str] = "morlax_torch.baselines.pg_morl.agent:PopulationAgent"
    generation: ClassVar[int | None] = None
    # iterations between two selections of what to train (None: at least 20, and so many that
    # measuring the policies takes at most about 8 % of the time)
    warmup: ClassVar[int] = 80  # iterations in which policies keep trade-offs of an even grid
    bins: ClassVar[int] = 100  # directions of the objective space in which policies are kept
    bin_size: ClassVar[int] = 2  # policies kept per direction
    candidates: ClassVar[int] = 7  # trade-offs considered for each of the kept policies
    sparsity: ClassVar[float] = 1.0  # weight of the front's sparsity, beside its hypervolume

    @property
    def num_networks(self) -> int:
        """R, the size of the archive."""
        return self.bins * self.bin_size
