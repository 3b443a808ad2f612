"""Agents of PG-MORL: separate policies, each with normalizers of its own."""

from typing import Any

import torch
from torch import Tensor

from ...configuration.config import Config
from ...envs.worlds.mirror import Mirror, Reflection
from ...networks.agent import Agent, Sizes
from ...networks.family import Family, Independent
from ...networks.normalizer import Normalizer


class InOrder(Independent):
    """R networks that share nothing and start alike; the k-th of R trade-offs gets the k-th."""

    def flat(self, conditions: Tensor) -> Tensor:
        assert len(conditions) == len(self.rows), "one trade-off per network"
        return self.rows


class Normalizers(Normalizer):
    """Statistics of R policies, the `rows`, each of its own inputs: (..., R, B, size) in all."""

    def __init__(self, size: int, rows: int, reflection: Reflection | None = None):
        super().__init__(size, reflection)
        for name in ("mean", "variance", "count", "scale"):
            start = self.get_buffer(name)
            setattr(self, name, start.repeat(rows, 1, 1))  # (R, 1, size), counts (R, 1, 1)

    def of(self, actor: Family, tradeoffs: Tensor) -> Normalizer:
        """Return a copy of the statistics of the actors of trade-offs (K, m), or of one (m,)."""
        if not isinstance(actor, Independent) or isinstance(actor, InOrder):
            return self
        chosen, copied = actor.chosen(tradeoffs), Normalizer(self.size)
        for name, start in copied.named_buffers():
            rows = self.get_buffer(name).index_select(0, chosen.reshape(-1))
            setattr(copied, name, rows if chosen.dim() else rows.view_as(start))
        return copied

    def _samples(self, x: Tensor) -> Tensor:
        return x.movedim(-3, 0).flatten(1, -2)


class PopulationAgent(Agent):
    """An archive of policies, of which a trade-off gets the one with the best weighted return.

    With `in_order`, there are so many policies instead, and the k-th of as many trade-offs gets the
    k-th one. Other arguments and errors are those of `Agent`.
    """

    def __init__(
        self, config: Config, sizes: Sizes, *others: Any, in_order: int = 0, **networks: Any
    ):
        super().__init__(config, sizes, *others, **networks)
        if in_order:
            self.num_networks = in_order
            keys = torch.zeros(in_order, sizes.objectives, dtype=torch.float32)  # unused
            self.actor, self.critic = (
                InOrder(family.target, keys)
                for family in (self.actor, self.critic)
                if isinstance(family, Independent)
            )
        mirror: Mirror | None = networks.get("mirror")
        reflection = mirror.observation if mirror else None
        size = self.observation_normalizer.size
        self.observation_normalizer = Normalizers(size, self.num_networks, reflection)
        self.value_normalizer = Normalizers(self.num_values, self.num_networks)


def belongings(agent: Agent) -> list[Tensor]:
    """Return views (R, ...) of all that belongs to each of R policies: networks, normalizers."""
    families = agent.actor, agent.critic
    rows = [family.rows.detach() for family in families if isinstance(family, Independent)]
    normalizers = agent.observation_normalizer, agent.value_normalizer
    return [*rows, *(x for normalizer in normalizers for x in normalizer.statistics())]
