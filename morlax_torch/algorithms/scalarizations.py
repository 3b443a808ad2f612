"""Scalarizations: how a trade-off turns the returns of several objectives into one utility."""

from collections.abc import Sequence
from typing import Any, Protocol

import torch
from torch import Tensor

from ..configuration.config import CONSTRAINED
from ..envs import MorlaxError, trust
from ..envs.errors import unknown, user_code
from ..envs.external import import_file
from ..gpu.group import ALONE, Group

FORGETTING = 0.01  # share by which the range shrinks towards today's returns, per iteration
SMOOTHNESS = 0.05  # mu, in units of the range between nadir and ideal
AUGMENTATION = 0.05  # rho
LEVELS = 33  # for which multipliers are kept, evenly from the nadir to the ideal point
RATE = 0.3  # of the multipliers, per iteration
MOST = 100.0  # of a multiplier


class Scalarization(Protocol):
    """A utility u(w, r) of the returns r of m objectives under a trade-off w, by its gradient.

    Learners follow it: with the expected returns of a policy, the derivative of u by the policy is
    that of every objective's return, weighed by du/dr (the chain rule). All methods run inside a
    recorded graph: fixed shapes, updates in place, no GPU sync.
    """

    uses_returns: bool = True
    """Whether the weights depend on the returns."""

    def weights(self, tradeoffs: Tensor, returns: Tensor) -> Tensor:
        """Return du/dr (K, m) at trade-offs (K, m) and expected returns (K, m)."""
        ...

    def observe(self, tradeoffs: Tensor, returns: Tensor, group: Group = ALONE) -> None:
        """Take note of expected returns (K, m) under trade-offs (K, m), before their `weights`."""

    def state(self) -> list[Tensor]:
        """Return the tensors that `observe` updates, in a fixed order."""
        return []

    def metrics(self, objectives: Sequence[str]) -> dict[str, Tensor]:
        """Return numbers () to log by name, of objectives with these names."""
        return {}


class WeightedSum(Scalarization):
    """The weighted sum u(w, r) = w . r, whose best policies lie on the convex part of a front."""

    uses_returns = False

    def weights(self, tradeoffs: Tensor, returns: Tensor) -> Tensor:
        return tradeoffs


class Ranged(Scalarization):
    """A scalarization that measures returns between a running ideal and nadir point.

    These are the best and worst expected return in each objective. A return beyond the range widens
    it at once. Otherwise both points move slowly towards today's best and worst returns, so that
    those of the first policies are forgotten.
    """

    def __init__(self, num_objectives: int, device: torch.device):
        most = torch.finfo(torch.float32).max  # the first returns replace it
        self.ideal = torch.full((num_objectives,), -most, dtype=torch.float32, device=device)
        self.nadir = -self.ideal

    def observe(self, tradeoffs: Tensor, returns: Tensor, group: Group = ALONE) -> None:
        best = group.largest_(torch.cat([returns.amax(0), -returns.amin(0)]))
        high, low = best[: len(self.ideal)], -best[len(self.ideal) :]
        slow_high = self.ideal + FORGETTING * (high - self.ideal)
        slow_low = self.nadir + FORGETTING * (low - self.nadir)
        seen = self.nadir <= self.ideal
        self.ideal.copy_(torch.where(seen, torch.maximum(slow_high, high), high))
        self.nadir.copy_(torch.where(seen, torch.minimum(slow_low, low), low))

    def scale(self) -> Tensor:
        """Return the width of the range (m,), above zero."""
        width = self.ideal - self.nadir
        return width.clamp(min=1e-6 * self.ideal.abs().clamp(min=1.0))

    def distances(self, returns: Tensor) -> Tensor:
        """Return how far returns (K, m) lie below the ideal point, in units of the range."""
        return (self.ideal - returns) / self.scale()

    def state(self) -> list[Tensor]:
        return [self.ideal, self.nadir]

    def metrics(self, objectives: Sequence[str]) -> dict[str, Tensor]:
        points = {"best_return": self.ideal, "worst_return": self.nadir}
        return {
            f"{kind}/{name}": value
            for kind, point in points.items()
            for name, value in zip(objectives, point, strict=True)
        }


class AugmentedChebyshev(Ranged):
    """u = -max_i w_i d_i - rho sum_i w_i d_i, with d_i the distance to the ideal point.

    (Steuer and Choo, 1983. `Ranged` defines the distance.) The gradient is that of the objective
    that lies furthest behind, and a little of all.
    """

    def weights(self, tradeoffs: Tensor, returns: Tensor) -> Tensor:
        behind = tradeoffs * self.distances(returns)
        furthest = torch.zeros_like(behind).scatter_(-1, behind.argmax(-1, keepdim=True), 1.0)
        return tradeoffs / self.scale() * (furthest + AUGMENTATION)


class SmoothChebyshev(Ranged):
    """u = -mu log sum_i exp(w_i d_i / mu), with d_i the distance to the ideal point.

    (Lin et al., 2024, "Smooth Tchebycheff Scalarization for Multi-Objective Optimization", eq. 6,
    for maximization. `Ranged` defines the distance.) All objectives count, the more the further
    they lie behind.
    """

    def weights(self, tradeoffs: Tensor, returns: Tensor) -> Tensor:
        behind = tradeoffs * self.distances(returns)
        return (behind / SMOOTHNESS).softmax(-1) * tradeoffs / self.scale()


class Constrained(Ranged):
    """Maximize the other objectives subject to r_c >= level, for all levels at once.

    The weight w_c of the constrained objective, with index c, is the required level: 0 is its worst
    return among all trade-offs, 1 its best (see `Ranged`). The other weights weigh the other
    objectives, in units of their ranges. The Lagrangian is

        u = sum_{i != c} w_i / (1 - w_c) r_i / range_i
            + lambda(w_c) ((r_c - nadir_c) / range_c - w_c)

    and gradient ascent on the policies takes turns with gradient descent on the multipliers
    lambda >= 0 (Arrow, Hurwicz and Uzawa, 1958), a piecewise linear function of the level.
    """

    def __init__(self, constrained: int, num_objectives: int, device: torch.device):
        super().__init__(num_objectives, device)
        self._c = constrained
        self.multipliers = torch.ones(LEVELS, dtype=torch.float32, device=device)
        self._others = torch.ones(num_objectives, dtype=torch.float32, device=device)
        self._others[constrained] = 0.0
        self._levels = torch.linspace(0, 1, LEVELS, dtype=torch.float32, device=device)

    def weights(self, tradeoffs: Tensor, returns: Tensor) -> Tensor:
        others = tradeoffs * self._others
        total = others.sum(-1, keepdim=True)
        even = self._others / self._others.sum()
        others = torch.where(total > 1e-6, others / total.clamp(min=1e-6), even)
        multiplier = self._near(tradeoffs) @ self.multipliers.to(tradeoffs)
        return (others + multiplier[:, None] * (1 - self._others)) / self.scale()

    def observe(self, tradeoffs: Tensor, returns: Tensor, group: Group = ALONE) -> None:
        super().observe(tradeoffs, returns, group)
        reached = (1 - self.distances(returns))[:, self._c]  # as a level
        missing = tradeoffs[:, self._c] - reached
        near = self._near(tradeoffs)
        sums = group.mean_(torch.stack([(near * missing[:, None]).sum(0), near.sum(0)]))
        mean = sums[0] / sums[1].clamp(min=1e-6)
        self.multipliers.add_(RATE * mean).clamp_(0.0, MOST)

    def state(self) -> list[Tensor]:
        return [*super().state(), self.multipliers]

    def metrics(self, objectives: Sequence[str]) -> dict[str, Tensor]:
        quarters = range(0, LEVELS, (LEVELS - 1) // 4)
        multipliers = {f"multiplier/{i / (LEVELS - 1):g}": self.multipliers[i] for i in quarters}
        return {**super().metrics(objectives), **multipliers}

    def _near(self, tradeoffs: Tensor) -> Tensor:
        """Return the shares (K, LEVELS) of the levels next to each required one."""
        distance = (tradeoffs[:, self._c, None] - self._levels).abs()
        return (1 - distance * (LEVELS - 1)).clamp(min=0.0)


class OwnUtility(Scalarization):
    """A differentiable function u(w, r) of trade-offs (K, m) and returns (K, m), to (K,).

    A recorded graph holds it: it consists of torch operations of fixed shape. MorlaxError, also
    from `weights`, says what is wrong with it. Its `name` is FILE.py:FUNCTION.
    """

    def __init__(self, name: str, num_objectives: int, device: torch.device):
        trust(name)
        self._name, (file, _, member) = name, name.rpartition(":")
        module = import_file(file, f"the utility {member}")
        functions: dict[str, Any] = {key: f for key, f in vars(module).items() if callable(f)}
        if member not in functions:
            raise unknown(f"function of {file}", member, functions)
        self._function = functions[member]
        corners = torch.eye(num_objectives, dtype=torch.float32, device=device)
        if not self.weights(corners, corners + 1.0).isfinite().all():
            raise MorlaxError(f"the derivative of the utility {name} is not finite.")

    @torch.enable_grad()
    def weights(self, tradeoffs: Tensor, returns: Tensor) -> Tensor:
        returns = returns.detach().requires_grad_()
        with user_code(f"the utility {self._name} fails", self._name.rpartition(":")[0]):
            utility = self._function(tradeoffs, returns)
        if not isinstance(utility, Tensor) or utility.shape != returns.shape[:1]:
            K, m = returns.shape
            shape = tuple(utility.shape) if isinstance(utility, Tensor) else type(utility).__name__
            raise MorlaxError(
                f"{self._name} must return one utility per row, ({K},) of trade-offs and returns "
                f"({K}, {m}), but returned {shape}."
            )
        try:
            return torch.autograd.grad(utility.sum(), returns)[0]
        except torch.OutOfMemoryError:
            raise
        except RuntimeError:
            raise MorlaxError(
                f"the utility {self._name} is not differentiable by the returns: use torch "
                "operations, without detach(), item() or comparisons alone."
            ) from None


def make_scalarization(name: str, objectives: Sequence[str], device: torch.device) -> Scalarization:
    """Make the scalarization that a config names, for returns of these objectives.

    It is linear, chebyshev, augmented-chebyshev, constrained:OBJECTIVE, or FILE.py:FUNCTION. The
    code of FILE.py runs, and files may name it from now on (see `envs.trust`).

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
    return OwnUtility(name, num_objectives, device)
