"""Find the trade-off that a user prefers, from comparisons of two behaviors at a time."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import entr, expit

from ...envs import MorlaxError
from ...evaluation.front import Front
from .session import Session, Weights

PARTICLES = 5_000
SHARPNESS = 15.0  # of choices: log odds per difference of the whole range of utilities
MISTAKES = 0.1  # share of answers that tell nothing about the preference
CANDIDATES = 300  # pairs of which the most informative one is asked about
NEAR = 0.05  # of the range of utilities: the user hardly sees a difference this small
COVERED = 0.95  # chance that the user's best is among the possible policies
SURE = 0.9  # confidence at which no more questions are needed


class Preference:
    """A user's weights of objectives, learned from answers to "A or B?".

    The user's utility is a sum of returns, each scaled to [0, 1] over the front, with unknown
    weights: at first all are equally likely, later those that explain the answers. The probability
    of an answer is that of Bradley and Terry (1952), with a share of mistakes. Particles represent
    the posterior, and the next pair is the one whose answer is expected to tell most about the
    weights (Lindley, 1956). Only non-dominated policies of the front are compared; raises
    MorlaxError if there are fewer than two.
    """

    def __init__(self, front: Front, seed: int = 0):
        self.policies = np.flatnonzero(front.non_dominated)
        if len(self.policies) < 2:
            raise MorlaxError("there is nothing to compare: the front has no two best policies.")
        returns = front.returns[self.policies]
        self._scaled = (returns - returns.min(0)) / np.ptp(returns, axis=0).clip(min=1e-12)
        self._random = np.random.default_rng(seed)
        self._weights = self._random.dirichlet(np.ones(returns.shape[1]), PARTICLES)
        self._log_posterior = np.zeros(PARTICLES)
        self._information = 0.0  # nats that the answer to the last pair is expected to tell
        # (PARTICLES, n), as shares of each particle's range
        utility = self._weights @ self._scaled.T
        self._utility = utility / np.ptp(utility, axis=1, keepdims=True).clip(min=1e-12)
        self._favorite = self._utility.argmax(1)

    def pair(self) -> tuple[int, int]:
        """Return the indices of two policies of the front to compare next."""
        n = len(self.policies)
        first, second = self._random.integers(n, size=(2, CANDIDATES))
        second = np.where(first == second, (first + 1) % n, second)
        chance, posterior = self._chance(first, second), self._posterior()
        # mutual information of an answer and the user's weights
        marginal, conditional = (entr(p) + entr(1 - p) for p in (posterior @ chance, chance))
        information = marginal - posterior @ conditional
        best = int(information.argmax())
        self._information = float(information[best])
        return int(self.policies[first[best]]), int(self.policies[second[best]])

    def answer(self, preferred: int, other: int) -> None:
        """Learn that the user prefers one of the compared policies to another, by their indices."""
        if others := {preferred, other} - set(self.policies.tolist()):
            raise MorlaxError(f"policy {others.pop()} is not one of the front's non-dominated.")
        pair = np.searchsorted(self.policies, [[preferred], [other]])
        self._log_posterior += np.log(self._chance(*pair)[:, 0])

    @property
    def weights(self) -> NDArray[np.float64]:
        """The expected weights (m,) of the objectives, each in units of its range."""
        return self._posterior() @ self._weights

    def best(self) -> int:
        """Return the index of the policy with the largest expected utility."""
        return int(self.policies[(self._scaled @ self.weights).argmax()])

    def possible(self) -> NDArray[np.intp]:
        """Return the fewest policies that include the user's best with a chance of `COVERED`."""
        chances = self._chances()
        ranked = np.argsort(-chances)
        enough = int(np.searchsorted(np.cumsum(chances[ranked]), COVERED)) + 1
        return np.sort(self.policies[ranked[:enough]])

    def confidence(self) -> float:
        """Return the probability that no policy is much better for the user than `best`."""
        best = np.searchsorted(self.policies, self.best())
        regret = self._utility.max(1) - self._utility[:, best]
        return float(self._posterior() @ (regret < NEAR))

    def questions_left(self) -> int:
        """Return about how many questions remain after `pair`; 0 if the answers suffice."""
        if self.confidence() >= SURE:
            return 0
        chances = self._chances()
        nats = float(entr(chances).sum())
        return max(1, round((1 - self.confidence()) * nats / max(self._information, 1e-3)))

    def _chances(self) -> NDArray[np.float64]:
        """Return the probability (n,) that each of `policies` is the user's best."""
        counts = np.bincount(self._favorite, self._posterior(), len(self.policies))
        return counts.astype(np.float64)

    def _posterior(self) -> NDArray[np.float64]:
        likelihood = np.exp(self._log_posterior - self._log_posterior.max())
        return likelihood / likelihood.sum()

    def _chance(self, first: np.ndarray, second: np.ndarray) -> NDArray[np.float64]:
        """Return the probabilities (PARTICLES, n) that each first policy is preferred."""
        gain = self._weights @ (self._scaled[first] - self._scaled[second]).T
        return MISTAKES / 2 + (1 - MISTAKES) * expit(SHARPNESS * gain)


class Comparison:
    """Shows two policies of a front with two robots; the next two follow each answer."""

    def __init__(self, front: Front, robots: tuple[Session, Session], seed: int = 0):
        self.robots = robots
        self._front, self._preference = front, Preference(front, seed)
        self._answers = 0
        self._told: dict[str, Any] | None = None  # the answer before
        self._ask()

    @property
    def best_tradeoff(self) -> Weights:
        """The trade-off that the user seems to like best."""
        return tuple(self._front.tradeoffs[self._preference.best()].tolist())

    def _ask(self) -> None:
        """Show other policies, each from the start of an episode."""
        self._pair = self._preference.pair()
        for session, policy in zip(self.robots, self._pair, strict=True):
            session.tradeoff = tuple(self._front.tradeoffs[policy].tolist())
            session.reset(self._answers)
        self._evidence = {
            "best_tradeoff": self.best_tradeoff,
            "possible": self._preference.possible().tolist(),  # indices on the front
            "confidence": self._preference.confidence(),
            "left": self._preference.questions_left(),
        }

    def state(self) -> dict[str, Any]:
        """Describe the answers so far, and their evidence, for a page."""
        return {"answers": self._answers, "told": self._told, **self._evidence}

    def answer(self, preferred: int) -> None:
        """Learn that the user prefers A (0) or B (1)."""
        self._told = {"preferred": preferred, "policies": self._pair}
        self._preference.answer(self._pair[preferred], self._pair[1 - preferred])
        self._answers += 1
        self._ask()

    def skip(self) -> None:
        self._told = None
        self._ask()
