"""The hypernetwork: a network whose output is the parameters of other networks."""

import copy
from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.func import functional_call, vmap

from ..gpu import fused
from .family import on_simplex
from .mlp import mlp, mlp_sizes


class Hypernetwork(nn.Module):
    """One network for every trade-off w, with parameters H(w) = M f(w) + b.

    f is an MLP from the simplex to F features. b starts as the parameters of `target` and M at
    zero, so that every trade-off starts from the same sensible network. Any module that
    `torch.vmap` can batch works (nn.LSTM does not; a loop over nn.GRUCell does). Its parameters
    are generated; its buffers are copied once and shared by the whole family.
    (MORLAX, "Policy representation"; HYPER-MORL introduced the affine form.)

        family = Hypernetwork(nn.Linear(3, 2), num_objectives=2)
        outputs = family.run(family(tradeoffs), inputs)  # (K, 2), (K, B, 3) -> (K, B, 2)

    Args:
        target: the module to generate parameters for; it is copied, not changed.
        num_objectives: m, the length of a trade-off.
        hidden_sizes: hidden layers of f.
        num_features: F.
        scale: M starts uniform in [-scale, scale].
        features: an f to share with another hypernetwork, instead of a new one.
        generator: draws the initial f and M.
    """

    def __init__(
        self,
        target: nn.Module,
        num_objectives: int,
        hidden_sizes: Sequence[int] = (128, 128),
        num_features: int = 16,
        *,
        scale: float = 0.0,
        features: nn.Module | None = None,
        generator: torch.Generator | None = None,
    ):
        super().__init__()
        parameters = dict(target.named_parameters())
        self.shapes = {name: value.shape for name, value in parameters.items()}
        self.sizes = [shape.numel() for shape in self.shapes.values()]
        self.features = features or mlp(num_objectives, hidden_sizes, num_features, generator)
        weight = torch.empty(sum(self.sizes), num_features)
        self.weight = nn.Parameter(nn.init.uniform_(weight, -scale, scale, generator))  # M
        self.bias = nn.Parameter(torch.cat([p.detach().flatten() for p in parameters.values()]))
        # The tuple hides the target from nn.Module: its own parameters are not used.
        self._target = (copy.deepcopy(target).requires_grad_(False),)
        self._mlp, self._features_mlp = mlp_sizes(target), mlp_sizes(self.features)
        self._names_of_buffers = list(dict(target.named_buffers()))
        for index, buffer in enumerate(target.buffers()):
            self.register_buffer(f"target_buffer_{index}", buffer.clone())

    def forward(self, tradeoffs: Tensor) -> dict[str, Tensor]:
        """Map trade-offs (K, m), scaled to sum to one, to parameters: name -> (K, *shape).

        Raises:
            MorlaxError: a trade-off is not finite or sums to zero (see `on_simplex`).
        """
        flat = fused.affine(self._featurize(on_simplex(tradeoffs)), self.weight, self.bias)
        named = zip(self.shapes.items(), flat.split(self.sizes, dim=-1), strict=True)
        return {name: values.reshape(-1, *shape) for (name, shape), values in named}

    def run(self, parameters: dict[str, Tensor], *inputs: Tensor):
        """Run K networks, each on its own inputs (K, ...); returns their outputs (K, ...).

        MLPs run in fused kernels where there are some; the result is always that of `torch.vmap`.
        """
        if self._mlp and len(inputs) == 1:
            generated = [parameters[name] for name in self.shapes]
            outputs = fused.mlps(self._mlp, generated, inputs[0])
            if outputs is not None:
                return outputs
        return vmap(self.run_one, randomness="different")(parameters, *inputs)

    def run_one(self, parameters: dict[str, Tensor], *inputs: Tensor):
        """Run one network, with parameters of the target's own shapes, on the target's inputs."""
        return functional_call(self._target[0], {**parameters, **self._buffers_of_family()}, inputs)

    def specialize(self, tradeoff: Tensor) -> nn.Module:
        """Return a plain copy of the target with the parameters of one trade-off (m,)."""
        network = copy.deepcopy(self._target[0]).to(tradeoff.device)
        with torch.no_grad():
            generated = self(tradeoff[None])
            for name, parameter in network.named_parameters():
                parameter.copy_(generated[name][0])
            for name, buffer in self._buffers_of_family().items():
                network.get_buffer(name).copy_(buffer)
        return network

    def _featurize(self, tradeoffs: Tensor) -> Tensor:
        """f: trade-offs (K, m) on the simplex to features (K, F)."""
        if self._features_mlp:
            parameters = [value[None] for value in self.features.parameters()]
            features = fused.mlps(self._features_mlp, parameters, tradeoffs[None])
            if features is not None:
                return features.squeeze(0)
        return self.features(tradeoffs)

    def _buffers_of_family(self) -> dict[str, Tensor]:
        names = enumerate(self._names_of_buffers)
        return {name: getattr(self, f"target_buffer_{index}") for index, name in names}
