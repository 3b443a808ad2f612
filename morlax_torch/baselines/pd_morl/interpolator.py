"""The direction of objective space that the returns of a trade-off should have."""

import torch
from torch import Tensor
from torch.nn.functional import cosine_similarity, normalize

from ...configuration.tradeoffs import typical_tradeoffs

PARALLEL = 0.9999  # cosine of vectors that count as parallel: the slope of acos has no limit


class Interpolator:
    """Interpolates between the returns of the key trade-offs: the corners and the balanced one.

    A sum of distances to the key trade-offs and a constant (radial basis functions of degree 1;
    Wright, 2003) goes through their returns, which are divided by their sum of absolute values.
    Until returns are known, the direction of a trade-off is the trade-off itself.
    """

    def __init__(self, num_objectives: int, device: torch.device):
        self.keys = typical_tradeoffs(num_objectives)
        points = self.keys.double()
        system = torch.ones(2 * [len(points) + 1], dtype=torch.float64)
        system[-1, -1] = 0.0
        system[:-1, :-1] = torch.cdist(points, points)
        self._inverse = system.inverse()
        self._points = self.keys.to(device)
        self._solutions = points.clone()  # (m + 1, m) the best returns
        self._known = torch.zeros((), dtype=torch.bool)
        self._coefficients = self._points.new_zeros(len(system), num_objectives)
        self._fit()

    def state(self) -> list[Tensor]:
        return [self._solutions, self._known, self._coefficients]

    def observe(self, returns: Tensor) -> None:
        """Keep the returns (m + 1, m) of key trade-offs whose weighted sum is the largest yet."""
        more = ((returns - self._solutions) * self.keys).sum(-1, keepdim=True) > 0
        self._solutions.copy_(torch.where(more | ~self._known, returns, self._solutions))
        self._known.fill_(True)
        self._fit()

    def _fit(self) -> None:
        values = normalize(self._solutions, p=1.0)
        self._coefficients.copy_(self._inverse @ torch.cat([values, torch.zeros_like(values[:1])]))

    def __call__(self, tradeoffs: Tensor) -> Tensor:
        """Map trade-offs (S, m) to directions (S, m) of any length."""
        distances = (tradeoffs[:, None] - self._points).norm(dim=-1, keepdim=True)
        # no matrix product, which would round to TF32
        return (distances * self._coefficients[:-1]).sum(1) + self._coefficients[-1]


def angle(one: Tensor, other: Tensor) -> Tensor:
    """Return the angle (...) between vectors (..., m) in degrees, from 0.8 to 90.

    Smaller and larger ones have no gradient, as in the authors' code of PD-MORL.
    """
    return cosine_similarity(one, other, -1).clamp(0.0, PARALLEL).acos().rad2deg()
