"""The hypernetwork: a network whose output is the parameters of other networks."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from ..envs.errors import MorlaxError
from ..gpu import fused
from .family import Generated, on_simplex
from .mlp import mlp, mlp_sizes

HIDDEN = (128, 128)  # units of f's layers


class Hypernetwork(Generated):
    """One network for every trade-off w, with parameters H(w) = M f(w) + b.

    f is an MLP from the simplex to F features, with a context c from both: H(w, c) = M f(w, c) + b.
    b starts as the parameters of `target` and M at zero, so that every trade-off starts from the
    same sensible network.
    (MORLAX, "Policy representation"; HYPER-MORL introduced the affine form.)

        family = Hypernetwork(nn.Linear(3, 2), num_objectives=2)
        outputs = family.run(family(tradeoffs), inputs)  # (K, 2), (K, B, 3) -> (K, B, 2)

    Args:
        target: the module to generate parameters for, which `Generated` can run; it is copied.
        num_objectives: m, the length of a trade-off.
        hidden_sizes: hidden layers of f.
        num_features: F.
        context_size: d, the length of a context (see `family`).
        scale: M starts uniform in [-scale, scale].
        features: an f to share with another hypernetwork, instead of a new one.
        generator: draws the initial f and M.

    Raises:
        MorlaxError: the target is no module with parameters, or updates buffers in training, or
            there is no objective.
    """

    def __init__(
        self,
        target: nn.Module,
        num_objectives: int,
        hidden_sizes: Sequence[int] = HIDDEN,
        num_features: int = 16,
        *,
        context_size: int = 0,
        scale: float = 0.0,
        features: nn.Module | None = None,
        generator: torch.Generator | None = None,
    ):
        super().__init__(target)
        if num_objectives < 1:
            raise MorlaxError(f"num_objectives is {num_objectives}: it must be at least 1.")
        self._inputs = inputs = num_objectives + context_size
        start = torch.cat([p.detach().flatten() for p in target.parameters()])
        features = features or mlp(inputs, hidden_sizes, num_features, generator, start.dtype)
        self.features = features.to(start.device)
        self._num_objectives = num_objectives
        self._features_mlp = mlp_sizes(self.features)
        weight = torch.empty(len(start), num_features, device="cpu", dtype=start.dtype)
        nn.init.uniform_(weight, -scale, scale, generator)
        self.weight = nn.Parameter(weight.to(start.device))  # M
        self.bias = nn.Parameter(start)

    def flat(self, conditions: Tensor) -> Tensor:
        if conditions.ndim != 2 or conditions.shape[1] != self._inputs:
            shape = tuple(conditions.shape)
            raise MorlaxError(f"trade-offs are (K, {self._inputs}) for this network, not {shape}.")
        inputs = on_simplex(conditions.to(self.bias.dtype), self._num_objectives)
        features = fused.mlp(inputs, self._features_mlp, self.features)  # (K, F)
        return torch.addmm(self.bias, features, self.weight.t())

    @torch.no_grad()
    def collapse(self, condition: Tensor) -> None:
        """Make every network that of one condition (m + d,), in place: b = H(w), M = 0."""
        self.bias.copy_(self.flat(condition[None])[0])
        self.weight.zero_()
