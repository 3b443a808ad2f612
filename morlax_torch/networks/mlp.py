"""Networks that families run: MLPs, symmetric ones, twin critics, and those that users bring."""

import copy
import math
from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.func import vmap

from ..envs import MorlaxError
from ..envs.errors import user_code
from ..envs.worlds.mirror import Reflection

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
    normalized: bool = False,
) -> nn.Sequential:
    """Build SiLU layers and a linear output layer, with LeCun-uniform weights and zero biases.

    With `normalized`, there is a layer normalization before each activation.
    """
    layers: list[nn.Module] = []
    for before, after in pairwise([inputs, *hidden, outputs]):
        linear = Linear(before, after, device="cpu", dtype=dtype)
        bound = math.sqrt(3 / before)
        nn.init.uniform_(linear.weight, -bound, bound, generator)
        nn.init.zeros_(linear.bias)
        norms = [nn.LayerNorm(after, device="cpu", dtype=dtype)] if normalized else []
        layers += [linear, *norms, nn.SiLU()]
    return nn.Sequential(*layers[: -2 if normalized else -1])


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


class Symmetric(nn.Module):
    """A network that answers a mirrored input by the mirrored output, or almost.

    f(x) = (1 + a) / 2 g(x) + (1 - a) / 2 M'g(Mx), where M and M' reflect inputs and outputs. With
    a = 0 that is exact (Ravindran and Barto, 2001, on symmetries of decisions; "NET" in
    Abdolhosseini et al., "On Learning Symmetric Locomotion", 2019). But then a robot that stands
    exactly symmetric moves both legs alike; with an `asymmetry` a > 0 it can take a first step.
    """

    def __init__(
        self, network: nn.Module, inputs: Reflection, outputs: Reflection, asymmetry: float = 0.0
    ):
        super().__init__()
        self.network, self.shares = network, ((1 + asymmetry) / 2, (1 - asymmetry) / 2)
        self.inputs_order, self.inputs_sign = map(nn.Buffer, inputs)
        self.outputs_order, self.outputs_sign = map(nn.Buffer, outputs)

    def forward(self, x: Tensor) -> Tensor:
        image = self.network(x.index_select(-1, self.inputs_order) * self.inputs_sign)
        image = image.index_select(-1, self.outputs_order) * self.outputs_sign  # for torch.jit
        return self.mixed(self.network(x), image)

    def mixed(self, plain: Tensor, mirrored: Tensor) -> Tensor:
        """Return f(x) from g(x) and M'g(Mx)."""
        return self.shares[0] * plain + self.shares[1] * mirrored


class Twins(nn.Module):
    """Two critics Q(s, a) of m objectives that share nothing.

    The smaller of two estimates counters overestimation (Fujimoto et al., 2018), and normalized
    layers keep values bounded where no data is (Ball et al., 2023).
    """

    def __init__(
        self,
        inputs: int,
        hidden: Sequence[int],
        num_objectives: int,
        generator: torch.Generator | None = None,
    ):
        super().__init__()
        self.networks = nn.ModuleList(
            mlp(inputs, hidden, num_objectives, generator, normalized=True) for _ in range(2)
        )

    def forward(self, x: Tensor) -> Tensor:
        """Map observations beside actions (..., inputs) to values (..., 2m), first by twin."""
        return torch.cat([network(x) for network in self.networks], -1)


def smaller(values: Tensor, weights: Tensor) -> Tensor:
    """Return the values (..., m) of the twin, of two (..., 2m), with the smaller weighted sum."""
    one, other = values.chunk(2, -1)
    less = (one * weights).sum(-1, True) < (other * weights).sum(-1, True)
    return torch.where(less, one, other)


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
    with user_code(f"the {name} cannot be copied"):
        rows, network = first.new_zeros(1, 2, inputs), copy.deepcopy(network)
    random = "error" if name == "actor" else "different"  # policies are deterministic
    before = [(id(buffer), buffer._version) for buffer in network.buffers()]
    try:
        with torch.no_grad():
            output = vmap(network, randomness=random)(rows)  # as a family runs it
    except RuntimeError as error:
        reason = str(error).splitlines()[0]
        if "random operation" in reason:
            reason = "it draws random numbers, as dropout does: pass it after .eval()."
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
    shape = tuple(output.shape[1:]) if isinstance(output, Tensor) else type(output).__name__
    if shape != (2, outputs):
        raise MorlaxError(
            f"the {name} maps observations (2, {inputs}) to {shape}, but it should return "
            f"(2, {outputs}): {MEANINGS[name]}."
        )
