"""Train with many bodies of a robot: each cluster of worlds has a body beside its trade-off."""

import torch
from torch import Tensor

from ..configuration.config import Config
from ..envs.worlds.design_space import DesignSpace, compile_bank
from ..envs.worlds.environment import Environment
from ..envs.worlds.mirroring import check


class DesignDraws:
    """Gives each of K clusters a body, for as long as an episode may last, and then another one.

    Clusters begin at even distances in time, so that a few of them change in each iteration.

    Args:
        env: the worlds, which adopt a bank of `config.sampling.designs` bodies.
        config: with K clusters.
        seed: of the bank.
    """

    def __init__(self, env: Environment, config: Config, seed: int):
        space, K = DesignSpace(env.designs), config.num_clusters
        self.env, self._each = env, config.worlds // K
        self.bank = compile_bank(env, space.spread(config.sampling.designs, seed))
        if config.network.symmetric and type(env).mirror is Environment.mirror:
            for row in {*self.bank.designs.argmin(0), *self.bank.designs.argmax(0)}:
                check(self.bank.models[row], config.network.symmetry_tolerance)
        contexts = torch.from_numpy(space.scaled(self.bank.designs)).float()
        self._contexts = contexts.to(env.device)  # (D, d)
        env.adopt(self.bank)
        self.rows = torch.zeros(K, dtype=torch.int64, device=env.device)  # of the bank
        # steps until a cluster changes its body; at first, all get one
        self.left = -(torch.arange(K, device=env.device) * env.episode_length // K)
        self.state = {"design_rows": self.rows, "design_steps": self.left}

    @property
    def context(self) -> Tensor:
        """(K, d)"""
        return self._contexts[self.rows]

    def draw(self, steps: int, generator: torch.Generator) -> Tensor:
        """Change the bodies that are due, before so many steps; returns which worlds, (N,) bool."""
        due = self.left <= 0
        drawn = torch.empty_like(self.rows).random_(0, len(self._contexts), generator=generator)
        self.rows.copy_(torch.where(due, drawn, self.rows))
        self.left.add_(torch.where(due, self.env.episode_length, 0)).sub_(steps)
        bodies, fresh = (x[:, None].expand(-1, self._each).flatten() for x in (self.rows, due))
        self.env.embody(bodies, fresh)
        return fresh
