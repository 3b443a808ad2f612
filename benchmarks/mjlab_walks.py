"""How the policies of a front walk in a velocity task of mjlab.

All walk in the same episodes: the same models, starts, commands and pushes.
"""

from typing import Any, NamedTuple

import numpy as np

from morlax_torch.configuration.config import Config
from morlax_torch.envs.bridges.mjlab.walking import QUANTITIES
from morlax_torch.evaluation.evaluator import make_evaluator
from morlax_torch.evaluation.front import Front

ERROR, SHARE, POWER = map(
    QUANTITIES.index, ("velocity error (m/s)", "speed (share of the commanded)", "power (W)")
)
WALKS = 0.7  # share of the commanded speed that counts as walking
FALLS = 0.2  # per 1,000 steps, at most, of a policy that walks


class Walks(NamedTuple):
    """A front, and the policies to report."""

    front: Front  # means over fresh episodes
    returns: np.ndarray  # (E, K, m) of each episode
    best: int  # index of the policy that tracks best
    cheapest: int | None  # of the one that walks with the least power, if any walks

    @property
    def falls(self) -> np.ndarray:
        """(K,) per 1,000 steps"""
        return 1000 * self.front.falls / self.front.lengths

    def told(self, index: int | None) -> tuple[list[float], dict[str, str]]:
        """Return the trade-off and the quantities of a policy (None: nothing)."""
        if index is None:
            return [], {}
        named = zip(self.front.quantity_names, self.front.quantities[index], strict=True)
        quantities = {name: f"{number:.3g}" for name, number in named}
        return self.front.tradeoffs[index].round(2).tolist(), quantities


def walk(agent: Any, config: Config, tradeoffs: int, episodes: int, seed: int) -> Walks:
    """Let policies walk; those to report are chosen in other episodes than the reported ones.

    Args:
        agent: an `Agent`, or what acts like one.
        config: of its run.
        tradeoffs: K.
        episodes: E, of each policy.
        seed: of the episodes.
    """
    means = make_evaluator(agent, config, "latched", tradeoffs, episodes, seed, sets=2)
    means.compile()
    front, trial = means.evaluate_sets()
    each = make_evaluator(agent, config, "latched", tradeoffs, 1, seed, sets=episodes)
    each.compile()
    returns = np.stack([one.returns for one in each.evaluate_sets()])
    walks = Walks(trial, returns, 0, None)
    error, share, power = trial.quantities[:, [ERROR, SHARE, POWER]].T
    walking = (share >= WALKS) & (walks.falls <= FALLS)
    cheapest = int(np.where(walking, power, np.inf).argmin()) if walking.any() else None
    return Walks(front, returns, int(error.argmin()), cheapest)


def dominated(returns: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return which policies (K,) one of the others dominates, given returns (E, K or L, m).

    Only differences of more than two standard errors over the E common episodes count: a policy
    dominates another one if it is better in an objective and worse in none.
    """
    differences = others[:, :, None] - returns[:, None]  # (E, L, K, m)
    error = differences.std(0, ddof=1) / len(returns) ** 0.5
    mean = differences.mean(0)
    better, worse = (mean > 2 * error).any(-1), (mean < -2 * error).any(-1)
    return (better & ~worse).any(0)
