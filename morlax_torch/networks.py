"""Plain networks: what the hypernetworks are made of, and what they make."""

import math
from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn


class Linear(nn.Linear):
    """`nn.Linear`, in two kernels instead of three where `vmap` batches its parameters."""

    def forward(self, input: Tensor) -> Tensor:
        return input @ self.weight.mT + self.bias


def mlp(
    inputs: int, hidden: Sequence[int], outputs: int, generator: torch.Generator | None = None
) -> nn.Sequential:
    """SiLU layers and a linear last one; LeCun-uniform kernels, zero biases."""
    layers: list[nn.Module] = []
    for before, after in pairwise([inputs, *hidden, outputs]):
        linear = Linear(before, after)
        bound = math.sqrt(3 / before)
        nn.init.uniform_(linear.weight, -bound, bound, generator)
        nn.init.zeros_(linear.bias)
        layers += [linear, nn.SiLU()]
    return nn.Sequential(*layers[:-1])
