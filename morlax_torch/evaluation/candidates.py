"""Search for the trade-offs that are worth simulating, given required values."""

import numpy as np
import torch

from .requirements import Requirements

NEIGHBORS = 8  # of each trade-off, if there are more than two objectives
FRACTIONS = np.linspace(0, 1, 20, endpoint=False)[1:, None]  # between two neighbors
DECIMALS = 5  # of weights; what is simulated can be printed
ERROR = 0.005  # of an evaluated value: least standard error, as a share of the range
LEAST_ERROR = 1e-6  # of one interpolated between simulated ones, likewise
GAIN = 0.005  # improvement that is worth a simulation, likewise
UNCONSTRAINED = 4  # candidates of the first batch that ignore the requirements, to know their cost


class Candidates:
    """Trade-offs with known values, and the ones between them.

    Known values promise something for a trade-off that was not simulated: those of an evaluation,
    or those interpolated between two neighbors. Promises are wrong by about as much as values
    differ between neighbors. A candidate's score is the probability that it keeps every
    requirement and gains on the best simulated one, if errors are independent and normal.
    (Constrained probability of improvement, as in Bayesian optimization.)

    Trade-offs, on the simplex, are (K, m), and values (K, m + q); `simulated` says whether the
    values are those of the simulation. A trade-off whose values are not finite is passed over: the
    trade-offs on both sides of it count as neighbors.
    """

    def __init__(
        self, tradeoffs: np.ndarray, values: np.ndarray, simulated: bool, required: Requirements
    ):
        self._required = required
        self.tradeoffs, first = np.unique(rounded(tradeoffs), axis=0, return_index=True)
        self.values = values[first].astype(float)
        self.promised = self.values.copy()  # (n, m + q)
        self.simulated = np.full(len(first), simulated)  # (n,)

    @property
    def kept(self) -> np.ndarray:
        """(n,) whether a trade-off was simulated and keeps every requirement."""
        return self.simulated & self._required.kept(self.values)

    def tell(self, tradeoffs: np.ndarray, promised: np.ndarray, values: np.ndarray) -> None:
        """Add simulated values (n, m + q) of proposed trade-offs (n, m)."""
        for tradeoff, promise, value in zip(tradeoffs, promised, values, strict=True):
            (same,) = (self.tradeoffs == tradeoff).all(1).nonzero()
            if len(same):
                self.values[same[0]], self.simulated[same[0]] = value, True
                continue
            self.tradeoffs = np.vstack([self.tradeoffs, tradeoff])
            self.promised = np.vstack([self.promised, promise])
            self.values = np.vstack([self.values, value])
            self.simulated = np.append(self.simulated, True)

    def propose(self, number: int) -> tuple[np.ndarray, np.ndarray, float]:
        """Return up to `number` trade-offs (n, m), promises (n, m + q) and the best's chance.

        There is at most one between each two neighbors, and one for equal values, so that the
        trade-offs are not all in one place.
        """
        tradeoffs, promised, errors = self._pool()
        scores = self._scores(promised, errors)
        order = (-scores).argsort(kind="stable")
        if not self.simulated.any():
            freely = (-promised[:, self._required.maximized]).argsort(kind="stable")
            order = np.concatenate([freely[:UNCONSTRAINED], order])
        order = order[np.sort(np.unique(order, return_index=True)[1])]  # first mention only
        _, first = np.unique(tradeoffs[order], axis=0, return_index=True)
        best = order[np.sort(first)[:number]]
        return tradeoffs[best], promised[best], float(np.exp(scores.max(initial=-np.inf)))

    def ranked(self) -> np.ndarray:
        """Return which simulated trade-offs keep the requirements, best first."""
        (indices,) = self.kept.nonzero()
        if len(indices) == 0:
            simulated = self.tradeoffs[self.simulated], self.values[self.simulated]
            raise self._required.missed(*simulated, "simulated")
        return indices[(-self.values[indices, self._required.maximized]).argsort(kind="stable")]

    def unconstrained(self) -> int:
        """Return the index of the simulated trade-off that has most of the maximized value."""
        value = self.values[:, self._required.maximized]
        return int(np.where(self.simulated & np.isfinite(value), value, -np.inf).argmax())

    def _pool(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return trade-offs to simulate (n, m), promises and standard errors (n, m + q)."""
        finite = self._required.finite(self.values)
        tradeoffs, simulated = self.tradeoffs[finite], self.simulated[finite]
        values = self._required.relevant(self.values[finite])
        one, other = _neighbors(tradeoffs)
        steps = values[other] - values[one]
        differences = np.zeros_like(values)
        for end in (one, other):
            np.add.at(differences, end, np.abs(steps))
        pairs = np.bincount(np.concatenate([one, other]), minlength=len(differences))
        rough = differences / pairs.clip(min=1)[:, None]  # (n, m + q) mean difference to neighbors
        unsure = np.where(simulated[:, None], LEAST_ERROR, ERROR) * self._required.span

        # trade-offs with equal values share a policy, and so do those between them
        _, different = np.unique(values, axis=0, return_index=True)
        alone = different[~simulated[different]]
        moving = steps.any(1)
        one, other, steps = one[moving], other[moving], steps[moving]

        t = FRACTIONS[None]
        between = (1 - t) * tradeoffs[one, None] + t * tradeoffs[other, None]
        promised = values[one, None] + t * steps[:, None]
        spread = (rough[one] + rough[other])[:, None] / 2
        least = np.maximum(unsure[one], unsure[other])[:, None]
        errors = np.hypot(least, spread * np.sqrt(0.25 + 2 * t * (1 - t)))  # most in the middle
        top = np.arange(len(one)), self._scores(promised, errors).argmax(1)

        proposed = rounded(np.concatenate([tradeoffs[alone], between[top]]))
        promised = np.concatenate([values[alone], promised[top]])
        errors = np.concatenate([np.hypot(unsure, rough / 2)[alone], errors[top]])
        seen = set(map(tuple, self.tradeoffs[self.simulated]))
        new = np.array([tuple(row) not in seen for row in proposed], dtype=bool)
        return proposed[new], promised[new], errors[new]

    def _scores(self, promised: np.ndarray, errors: np.ndarray) -> np.ndarray:
        """Return log probabilities (...) of promises and standard errors (..., m + q)."""
        required = self._required
        excess = required.excess(promised) / errors[..., required.limited]
        score = _log_normal(excess).sum(-1)
        known = self.kept if self.simulated.any() else required.kept(self.values)
        if known.any():
            index = required.maximized
            best = self.values[known, index].max() + GAIN * required.span[index]
            score = score + _log_normal((promised[..., index] - best) / errors[..., index])
        return score


def _neighbors(tradeoffs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of both trade-offs (n, m) of each pair of neighbors."""
    if tradeoffs.shape[1] == 2:
        order = tradeoffs[:, 0].argsort(kind="stable")
        return order[:-1], order[1:]
    squares = (tradeoffs**2).sum(1)
    distances = squares[:, None] + squares - 2 * tradeoffs @ tradeoffs.T
    np.fill_diagonal(distances, np.inf)
    near = distances.argsort(1, kind="stable")[:, : min(NEIGHBORS, len(squares) - 1)]
    pairs = np.stack([np.arange(len(near)).repeat(near.shape[1]), near.ravel()], 1)
    pairs = np.unique(np.sort(pairs, 1), axis=0)
    return pairs[:, 0], pairs[:, 1]


def rounded(tradeoffs: np.ndarray) -> np.ndarray:
    """Scale trade-offs (n, m) to sum to one and round them, so that the decimals sum to one too."""
    scaled = tradeoffs / tradeoffs.sum(1, keepdims=True)
    units = np.rint(scaled * 10**DECIMALS)
    rows = np.arange(len(units))
    units[rows, units.argmax(1)] += 10**DECIMALS - units.sum(1)
    return units / 10**DECIMALS


def _log_normal(values: np.ndarray) -> np.ndarray:
    return torch.special.log_ndtr(torch.from_numpy(np.ascontiguousarray(values))).numpy()
