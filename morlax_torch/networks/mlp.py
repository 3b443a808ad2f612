"""Plain networks: MLPs, and checks of networks that users bring."""

import copy
import math
from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.func import vmap

from ..envs import MorlaxError

MEANINGS = {
    "actor": "a mean and a spread per action dimension",
    "critic": "one value per objective, or a single one with ppo.critic scalar",
}


class Linear(nn.Linear):
    """`nn.Linear` that takes two kernels instead of three when `vmap` batches its parameters."""

    def forward(self, input: Tensor) -> Tensor:
        return input @ self.weight.mT + self.bias


def mlp(
    inputs: int,
    hidden: Sequence[int],
    outputs: int,
    generator: torch.Generator | None = None,
    dtype: torch.dtype = torch.float32,
) -> nn.Sequential:
    """Build SiLU layers and a linear output layer, with LeCun-uniform weights and zero biases."""
    layers: list[nn.Module] = []
    for before, after in pairwise([inputs, *hidden, outputs]):
        linear = Linear(before, after, dtype=dtype)
        bound = math.sqrt(3 / before)
        nn.init.uniform_(linear.weight, -bound, bound, generator)
        nn.init.zeros_(linear.bias)
        layers += [linear, nn.SiLU()]
    return nn.Sequential(*layers[:-1])


def mlp_sizes(network: nn.Module) -> tuple[int, ...] | None:
    """Return inputs, hidden layers and outputs of a network like those of `mlp`, None of others."""
    if type(network) is not nn.Sequential or len(network) < 3 or len(network) % 2 == 0:
        return None
    layers, activations = list(network)[::2], list(network)[1::2]
    kinds = (Linear, nn.Linear)  # a subclass may compute something else
    linear = [x for x in layers if isinstance(x, nn.Linear) and type(x) in kinds]
    plain = len(linear) == len(layers) and all(type(x) is nn.SiLU for x in activations)
    if not plain or len(list(network.parameters())) < 2 * len(linear):  # shared, or without bias
        return None
    return linear[0].in_features, *(layer.out_features for layer in linear)


def check_network(name: str, network: nn.Module, inputs: int, outputs: int) -> None:
    """Raise MorlaxError unless a user's network maps (B, inputs) to (B, outputs)."""
    first = next(network.parameters(), None)
    if first is None:
        raise MorlaxError(f"the {name} has no parameters, so there is nothing to generate.")
    if first.dtype != torch.float32:
        raise MorlaxError(
            f"the {name} has parameters of {first.dtype}, but networks compute in float32: use "
            ".float()."
        )
    rows, network = first.new_zeros(1, 2, inputs), copy.deepcopy(network)
    before = [(id(buffer), buffer._version) for buffer in network.buffers()]
    try:
        with torch.no_grad():
            found = vmap(network, randomness="different")(rows)  # as a family runs it
    except RuntimeError as error:
        reason = str(error).splitlines()[0]
        raise MorlaxError(f"the {name} cannot take observations (2, {inputs}): {reason}") from None
    try:
        copy.deepcopy(network)  # fails if the network holds tensors of inside vmap
        kept = before != [(id(buffer), buffer._version) for buffer in network.buffers()]
    except RuntimeError:
        kept = True
    if kept:
        raise MorlaxError(
            f"the {name} keeps tensors from call to call: let its forward change no buffer or "
            "attribute."
        )
    shape = tuple(found.shape[1:]) if isinstance(found, Tensor) else type(found).__name__
    if shape != (2, outputs):
        raise MorlaxError(
            f"the {name} maps observations (2, {inputs}) to {shape}, but it should return "
            f"(2, {outputs}): {MEANINGS[name]}."
        )
