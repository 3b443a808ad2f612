"""Scalarizations by name, and a user's own."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from ...configuration.config import CONSTRAINED
from ...envs import MorlaxError, trust
from ...envs.errors import located, unknown
from ...envs.external import import_file
from .interface import AugmentedChebyshev, Constrained, Scalarization, SmoothChebyshev, WeightedSum

Utility = Callable[[Tensor, Tensor], Tensor]


def make_scalarization(name: str, objectives: Sequence[str], device: torch.device) -> Scalarization:
    """Make the scalarization that a config names.

    Args:
        name: linear, chebyshev, augmented-chebyshev, constrained:OBJECTIVE, or FILE.py:FUNCTION.
        objectives: their names.
        device: of the returns.

    The code of FILE.py runs, and files may name it from now on (see `envs.trust`).

    Raises:
        MorlaxError: the file has no such function, or the function cannot be used.
    """
    num_objectives = len(objectives)
    if name == "linear":
        return WeightedSum()
    if name == "chebyshev":
        return SmoothChebyshev(num_objectives, device)
    if name == "augmented-chebyshev":
        return AugmentedChebyshev(num_objectives, device)
    if name.startswith(CONSTRAINED):
        constrained = objectives.index(name.removeprefix(CONSTRAINED))
        return Constrained(constrained, num_objectives, device)
    trust(name)
    file, _, member = name.rpartition(":")
    module = import_file(file, f"the utility {member}")
    functions = {key for key, value in vars(module).items() if callable(value)}
    if member not in functions:
        raise unknown(f"function of {file}", member, functions)
    return OwnUtility(getattr(module, member), name, num_objectives, device)


class OwnUtility(Scalarization):
    """A differentiable function u(w, r) of trade-offs (K, m) and returns (K, m), to (K,).

    A recorded graph holds it: it consists of torch operations of fixed shape.

    Raises:
        MorlaxError: from every method, if the function fails, has another shape, or is not
            differentiable.
    """

    def __init__(self, function: Utility, name: str, num_objectives: int, device: torch.device):
        self._function, self._name = function, name
        corners = torch.eye(num_objectives, dtype=torch.float32, device=device)
        if not self.weights(corners, corners + 1.0).isfinite().all():
            raise MorlaxError(f"the derivative of the utility {name} is not finite.")

    def utility(self, tradeoffs: Tensor, returns: Tensor) -> Tensor:
        try:
            utility = self._function(tradeoffs, returns)
        except (MemoryError, torch.OutOfMemoryError):
            raise
        except (Exception, SystemExit) as error:  # any error of the user's own code
            reason = located(error, self._name.rpartition(":")[0])
            raise MorlaxError(f"the utility {self._name} fails: {reason}") from error
        if not isinstance(utility, Tensor) or utility.shape != returns.shape[:1]:
            K, m = returns.shape
            shape = tuple(utility.shape) if isinstance(utility, Tensor) else type(utility).__name__
            raise MorlaxError(
                f"{self._name} must return one utility per row, ({K},) of trade-offs and returns "
                f"({K}, {m}), but returned {shape}."
            )
        return utility

    def weights(self, tradeoffs: Tensor, returns: Tensor) -> Tensor:
        with torch.enable_grad():
            returns = returns.detach().requires_grad_()
            utility = self.utility(tradeoffs, returns)
            try:
                (slope,) = torch.autograd.grad(utility.sum(), returns)
            except torch.OutOfMemoryError:
                raise
            except RuntimeError:
                raise MorlaxError(
                    f"the utility {self._name} is not differentiable by the returns: use torch "
                    "operations, without detach(), item() or comparisons alone."
                ) from None
        return slope
