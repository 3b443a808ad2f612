"""Families of networks, one network per condition: conditioned, generated and separate ones.

A condition is a trade-off of m weights and, in families of robots whose bodies differ, d numbers of
context, which describe the body.
"""

import copy
import threading
from abc import ABC, abstractmethod
from functools import partial
from typing import Any, Self

import torch
from torch import Tensor, nn
from torch.func import functional_call, vmap

from ..envs.errors import MorlaxError, shortened, user_code
from ..envs.worlds.mirror import Reflection
from ..gpu import fused
from .mlp import Symmetric, mlp_sizes


class Family(nn.Module, ABC):
    """A network for every condition: `Hypernetwork`, `Conditioned` or `Independent`."""

    shapes: dict[str, torch.Size]
    """Parameters of the network that a user may have made, by name."""

    def __init__(self, network: nn.Module):
        super().__init__()
        self.shapes = {name: value.shape for name, value in network.named_parameters()}

    @abstractmethod
    def forward(self, conditions: Tensor) -> dict[str, Tensor]:
        """Map conditions (K, m + d) to parameters by name, (K, ...) each.

        `on_simplex` scales their trade-offs to sum to one, or raises MorlaxError.
        """

    @abstractmethod
    def run(self, parameters: dict[str, Tensor], *inputs: Tensor) -> Tensor:
        """Run K networks, each on its own inputs (K, B, ...), to outputs (K, B, ...).

        MLPs run in fused kernels where there are some; results are the same up to rounding.
        """

    @abstractmethod
    def run_one(self, parameters: dict[str, Tensor], *inputs: Tensor) -> Tensor:
        """Run one network, with parameters (...) each, on its inputs (B, ...)."""

    @abstractmethod
    def specialize(self, condition: Tensor) -> nn.Module:
        """Return a plain copy of the network of one condition (m + d,), which can learn alone."""


def on_simplex(conditions: Tensor, num_objectives: int | None = None) -> Tensor:
    """Scale the trade-offs of conditions (K, m + d) to sum to one (None: d is 0).

    Raises:
        MorlaxError: a trade-off is not finite or sums to 0 or less. Recorded and exported graphs
            and `torch.func` cannot look at numbers, so there it gives numbers that are not finite.
    """
    m = num_objectives
    if m is not None and m < conditions.shape[-1]:
        return torch.cat([on_simplex(conditions[..., :m]), conditions[..., m:]], -1)
    sums = conditions.sum(-1, keepdim=True)
    capturing = torch.cuda.is_available() and torch.cuda.is_current_stream_capturing()
    unseen = capturing or torch.jit.is_tracing() or torch.compiler.is_compiling()
    unseen = unseen or torch._C._are_functorch_transforms_active()
    if not (unseen or (conditions.isfinite() & (sums > 0)).all()):
        raise MorlaxError("a trade-off must be finite, and the sum of its weights above 0.")
    return conditions / sums


class Conditioned(Family):
    """One network for every trade-off w, which it takes beside its input x: g(x, w).

    (AMOR: Alegre et al., 2025. A hypernetwork instead generates the network's parameters.) The
    network, which is copied, maps rows (B, inputs + m + d) to (B, outputs). `num_objectives` is m
    if conditions have a context.
    """

    def __init__(self, network: nn.Module, num_objectives: int | None = None):
        super().__init__(network)
        self._num_objectives = num_objectives
        self.network = copy.deepcopy(network)
        self._mlp = mlp_sizes(network)

    def forward(self, conditions: Tensor) -> dict[str, Tensor]:
        return {"condition": on_simplex(conditions, self._num_objectives)}

    def run(self, parameters: dict[str, Tensor], *inputs: Tensor) -> Tensor:
        (x,) = inputs
        rows = _beside(x, parameters["condition"][:, None]).flatten(0, 1)
        return fused.mlp(rows, self._mlp, self.network).unflatten(0, x.shape[:2])

    def run_one(self, parameters: dict[str, Tensor], *inputs: Tensor) -> Tensor:
        (x,) = inputs
        return self.network(_beside(x, parameters["condition"]))

    def specialize(self, condition: Tensor) -> nn.Module:
        network = copy.deepcopy(self.network).to(condition.device)
        return _Fixed(network, on_simplex(condition, self._num_objectives))


class _Fixed(nn.Module):
    """The network under one condition (m + d,)."""

    def __init__(self, network: nn.Module, condition: Tensor):
        super().__init__()
        self.network = network
        self.condition = nn.Buffer(condition.clone())

    def forward(self, x: Tensor) -> Tensor:
        return self.network(_beside(x, self.condition))


def _beside(x: Tensor, condition: Tensor) -> Tensor:
    """Return x (..., inputs) with the condition (..., c) in every row, (..., inputs + c)."""
    # not `expand`: traced, it would fix the number of rows
    return torch.cat([x, torch.zeros_like(x[..., :1]) + condition], -1)


class PerThread(threading.local):
    """A copy of a module for each thread: `functional_call` swaps a module's parameters."""

    def __init__(self, module: nn.Module):  # called by every thread that uses the object
        self.original, self.copy = module, copy.deepcopy(module)

    def __reduce__(self) -> tuple[Any, ...]:
        return PerThread, (self.original,)


class Generated(Family):
    """Runs copies of a target module, each with its own parameters.

    A subclass maps conditions (K, m + d) to rows of P parameters (`flat`). Any target that
    `torch.vmap` can batch works (nn.LSTM does not; a loop over nn.GRUCell does). Its buffers are
    copied once and shared by the whole family. The target itself is copied, not changed.
    """

    def __init__(self, target: nn.Module):
        if not isinstance(target, nn.Module):
            raise MorlaxError(f"the target must be an nn.Module, not {shortened(target)}.")
        super().__init__(target)
        if not self.shapes:
            raise MorlaxError("the target has no parameters, so there is nothing to generate.")
        types = {str(p.dtype): p.is_floating_point() for p in target.parameters()}
        if [*types.values()] != [True]:
            raise MorlaxError(
                f"the target's parameters must be of one floating type, not {' and '.join(types)}."
            )
        for module in target.modules():
            kind = type(module).__name__.lstrip("_")
            tracks = getattr(module, "running_mean", None) is not None or kind == "SpectralNorm"
            if tracks and module.training:
                raise MorlaxError(
                    f"the target's {kind} updates buffers in training, which all networks would "
                    "share: use nn.LayerNorm, or pass the target after .eval()."
                )
        self.sizes = [shape.numel() for shape in self.shapes.values()]
        with user_code("the target cannot be copied"):  # such as with the former weight_norm
            # nn.Module does not see the target inside: its own parameters are not used
            self._target = PerThread(copy.deepcopy(target).requires_grad_(False))
        self._mlp = mlp_sizes(target.network if isinstance(target, Symmetric) else target)
        self._names_of_buffers = list(dict(target.named_buffers()))
        for index, buffer in enumerate(target.buffers()):
            self.register_buffer(f"target_buffer_{index}", buffer.clone())

    @property
    def target(self) -> nn.Module:
        """The module whose parameters are generated."""
        return self._target.original

    def train(self, mode: bool = True) -> Self:
        """Set whether dropout and its like are active, as `nn.Module.train`; so does `eval`."""
        self._target = PerThread(self.target.train(mode))
        return super().train(mode)

    @abstractmethod
    def flat(self, conditions: Tensor) -> Tensor:
        """Map conditions (K, m + d) to parameters (K, P), in the order of `shapes`."""

    def forward(self, conditions: Tensor) -> dict[str, Tensor]:
        return self.split(self.flat(conditions))

    def split(self, flat: Tensor) -> dict[str, Tensor]:
        """Return the parameters (..., *shape) that rows (..., P) consist of, by name."""
        named = zip(self.shapes.items(), flat.split(self.sizes, dim=-1), strict=True)
        return {name: values.reshape((*flat.shape[:-1], *shape)) for (name, shape), values in named}

    def run(self, parameters: dict[str, Tensor], *inputs: Tensor) -> Tensor:
        definition = partial(vmap(self.run_one, randomness="different"), parameters, *inputs)
        if not self._mlp or len(inputs) != 1:
            return definition()
        target, generated = self._target.copy, [parameters[name] for name in self.shapes]
        if not isinstance(target, Symmetric):
            return fused.mlps(inputs[0], self._mlp, generated, definition)
        # one call for the rows and their images
        inside = {name.removeprefix("network."): parameters[name] for name in self.shapes}
        run, buffers = vmap(partial(functional_call, target.network)), self._buffers_of_family()
        mirror_inputs = Reflection(buffers["inputs_order"], buffers["inputs_sign"])
        mirror_outputs = Reflection(buffers["outputs_order"], buffers["outputs_sign"])
        rows = torch.cat([inputs[0], mirror_inputs(inputs[0])], 1)
        outputs = fused.mlps(rows, self._mlp, generated, partial(run, inside, rows))
        plain, image = outputs.chunk(2, 1)
        return target.mixed(plain, mirror_outputs(image))

    def run_one(self, parameters: dict[str, Tensor], *inputs: Tensor) -> Tensor:
        named = {**parameters, **self._buffers_of_family()}
        return functional_call(self._target.copy, named, inputs, strict=True)

    def specialize(self, condition: Tensor) -> nn.Module:
        with torch.no_grad():
            network = copy.deepcopy(self.target)
            values = {**self.split(self.flat(condition[None])[0]), **self._buffers_of_family()}
            for name, tensor in [*network.named_parameters(), *network.named_buffers()]:
                tensor.data = values[name].clone()  # its device and type, too
        return network.requires_grad_()

    def _buffers_of_family(self) -> dict[str, Tensor]:
        names = enumerate(self._names_of_buffers)
        return {name: getattr(self, f"target_buffer_{index}") for index, name in names}


class Independent(Generated):
    """R networks that share no parameters, for `keys` (R, m); a trade-off gets the nearest one.

    For w, that is the network r with the largest w . keys[r] + offsets[r], where offsets are
    -|keys[r]|²/2. All networks start as the target.
    """

    def __init__(self, target: nn.Module, keys: Tensor):
        super().__init__(target)
        start = torch.cat([p.detach().flatten() for p in target.parameters()])
        self.rows = nn.Parameter(start.repeat(len(keys), 1))  # (R, P)
        self.keys = nn.Buffer(keys.clone())  # (R, m)
        self.offsets = nn.Buffer(keys.square().sum(-1) / -2)  # (R,)

    def flat(self, conditions: Tensor) -> Tensor:
        return self.rows.index_select(0, self.chosen(conditions))

    def chosen(self, tradeoffs: Tensor) -> Tensor:
        """Return the index (K,) of the network of each trade-off (K, m)."""
        # no matrix product, which GPUs round to TF32: keys may differ by less than that
        products = on_simplex(tradeoffs)[..., None, :] * self.keys
        return (products.sum(-1) + self.offsets).argmax(-1)
