"""Actors as rsl_rl trains them: any activation, actions without bounds."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor, nn

from ..configuration.config import Config
from ..configuration.sections import RslRlOptions
from ..envs import MorlaxError
from .agent import Agent

MOST = 1 - 1e-6  # of a squashed action, so that its atanh is finite


class GaussianMLP(nn.Module):
    """A network `mlp` of means, and `std` (A,) of every input, which may be its logarithm."""

    def __init__(self, mlp: nn.Module, std: Tensor):
        super().__init__()
        self.mlp, self.std = mlp, nn.Parameter(std.detach().clone())


class Squashed(GaussianMLP):
    """The network of a `GaussianMLP` as an actor of `Agent`.

    `Agent` squashes means by tanh. So that the action is mean / scale, up to the bounds, the output
    is its atanh. Standard deviations are not kept.
    """

    def __init__(self, sizes: Sequence[int], activation: str, scale: float):
        layers: list[nn.Module] = []
        for before, after in pairwise(sizes):
            layers += [nn.Linear(before, after), getattr(nn, activation)()]
        super().__init__(nn.Sequential(*layers[:-1]), torch.zeros(sizes[-1], dtype=torch.float32))
        self.scale = scale

    def forward(self, x: Tensor) -> Tensor:
        action = (self.mlp(x) / self.scale).clamp(-MOST, MOST)
        return torch.cat([action.atanh(), torch.zeros_like(action)], -1)


class RslRlAgent(Agent):
    """The policies of a checkpoint that `ParetoPPO` has written, without critics."""

    def __init__(self, config: Config, task: Any, **others: Any):
        assert isinstance(config.method, RslRlOptions)
        if (scale := getattr(config.task, "action_scale", None)) is None:
            raise MorlaxError(f"{config.env} has no action_scale, which rsl_rl's policies need.")
        layers = task.observation_size, *config.network.actor, task.action_size
        super().__init__(config, task, actor=Squashed(layers, config.method.activation, scale))
        self._own = []  # the config describes the actor
        self.observation_normalizer.limit = math.inf
