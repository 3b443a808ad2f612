"""A user's own utility."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from ..envs import MorlaxError
from ..envs.errors import LONGEST
from ..gpu.group import ALONE, Group

Utility = Callable[[Tensor, Tensor], Tensor]


class OwnUtility:
    """A differentiable function u(w, r) of trade-offs (K, m) and returns (K, m), to (K,).

    Args:
        function: of torch operations of fixed shape, so that a recorded graph can hold it.
        name: for error messages.
        num_objectives: m.
        device: of the returns.

    Raises:
        MorlaxError: the function fails, has another shape, or is not differentiable.
    """

    uses_returns = True

    def __init__(self, function: Utility, name: str, num_objectives: int, device: torch.device):
        self._function = function
        self._check(name, num_objectives, device)

    def utility(self, tradeoffs: Tensor, returns: Tensor) -> Tensor:
        return self._function(tradeoffs, returns)

    def weights(self, tradeoffs: Tensor, returns: Tensor) -> Tensor:
        with torch.enable_grad():
            given = returns.detach().requires_grad_()
            (slope,) = torch.autograd.grad(self._function(tradeoffs, given).sum(), given)
        return slope

    def observe(self, tradeoffs: Tensor, returns: Tensor, group: Group = ALONE) -> None:
        pass

    def state(self) -> list[Tensor]:
        return []

    def metrics(self, objectives: Sequence[str]) -> dict[str, Tensor]:
        return {}

    def _check(self, name: str, m: int, device: torch.device) -> None:
        corners = torch.eye(m, device=device)
        shape = f"{name} must return one utility per row, ({m},) of trade-offs and returns"
        try:
            found = self._function(corners, corners + 1.0)
        except Exception as error:  # any error of the user's own code
            reason = " ".join(f"{type(error).__name__}: {error}".split())[:LONGEST]
            raise MorlaxError(f"the utility {name} fails: {reason}") from None
        if not isinstance(found, Tensor) or found.shape != (m,):
            raise MorlaxError(f"{shape} ({m}, {m}), but returned {_kind(found)}.")
        try:
            slope = self.weights(corners, corners + 1.0)
        except RuntimeError:
            raise MorlaxError(
                f"the utility {name} is not differentiable by the returns: use torch operations, "
                "without detach(), item() or comparisons alone."
            ) from None
        if not slope.isfinite().all():
            raise MorlaxError(f"the derivative of the utility {name} is not finite.")


def _kind(value: object) -> str:
    return f"{tuple(value.shape)}" if isinstance(value, Tensor) else type(value).__name__
