"""Search over bodies and trade-offs together, of a family of policies that knows many bodies."""

from collections.abc import Mapping
from typing import NamedTuple, Self

import numpy as np
import torch

from ..configuration.tradeoffs import evaluation_tradeoffs
from ..envs import MorlaxError
from ..envs.worlds.design_space import DesignSpace
from ..envs.worlds.environment import Environment
from ..evaluation import pareto
from ..evaluation.evaluator import Evaluator
from ..evaluation.making import embody, evaluation_worlds
from ..evaluation.names import Names
from ..evaluation.requirements import Requirements
from ..host.phases import phase
from ..networks.policy import Policy
from .storage import optuna, quiet

BATCH = {"cuda": 32_768, "cpu": 2048}  # policies that are simulated together


class Simulated(NamedTuple):
    """Policies by body and trade-off, with the values that they reached."""

    designs: np.ndarray  # (n, d)
    tradeoffs: np.ndarray  # (n, m)
    values: np.ndarray  # (n, m + q) returns, then quantities; NaN: the design makes no body

    def joined(self, other: Self) -> Self:
        return type(self)(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))

    def rows(self, which: np.ndarray) -> Self:
        return type(self)(*(column[which] for column in self))

    @property
    def returns(self) -> np.ndarray:
        """(n, m)"""
        return self.values[:, : self.tradeoffs.shape[1]]


class Designer:
    """Simulates policies of any body and trade-off, on the policy's device.

    Args:
        policy: trained with designs.
        seed: random seed of the worlds, if the task is random.

    Raises:
        MorlaxError: the policy was trained with one body.
    """

    def __init__(self, policy: Policy, seed: int = 0):
        if not len(policy.agent.context):
            raise MorlaxError(
                "these policies were trained with one body: train with --sampling.designs 1024, a "
                "task with design parameters (docs/designs.md)."
            )
        place = policy.agent.context.device
        self.policy, self.space, self._seed = policy, DesignSpace(policy.agent.designs), seed
        self._config = policy.config.model_copy(update={"device": str(place), "backend": None})
        self._batch = BATCH[place.type]
        self.quantities: tuple[str, ...] = ()
        self.reference_point = np.zeros(len(policy.objectives))

    def simulate(self, designs: np.ndarray, tradeoffs: np.ndarray) -> Simulated:
        """Simulate pairs of designs (n, d) and trade-offs (n, m), one episode or more of each."""
        parts = []
        for first in range(0, len(designs), self._batch):
            phase(f"simulating {len(designs)} bodies and trade-offs", first / len(designs))
            own = slice(first, first + self._batch)
            parts.append(self._together(designs[own], tradeoffs[own]))
        return Simulated(designs, tradeoffs, np.concatenate(parts))

    def _together(self, designs: np.ndarray, tradeoffs: np.ndarray) -> np.ndarray:
        config, seeds = self._config, self._config.evaluation.seeds
        env = evaluation_worlds(config, len(designs), seeds, self._seed)
        assert isinstance(env, Environment)
        different, rows = np.unique(designs, axis=0, return_inverse=True)
        rows = rows.reshape(-1)  # numpy 2.0 gives it another shape
        kept = embody(env, different, torch.from_numpy(rows).repeat(seeds))
        conditions = np.concatenate([tradeoffs, self.space.scaled(designs)], 1)
        evaluator = Evaluator(
            self.policy.agent,
            env,
            torch.from_numpy(conditions).float(),
            config.evaluation.protocol,
            self._seed,
            seeds,
        )
        evaluator.compile()
        self.quantities, self.reference_point = env.quantities, evaluator.reference_point
        values = evaluator.evaluate().values.astype(float)
        values[~kept[rows]] = np.nan
        return values

    def grid(self, bodies: int, tradeoffs: int, seed: int) -> Simulated:
        """Simulate the default body and others, spread evenly, each with the same trade-offs."""
        points = evaluation_tradeoffs(tradeoffs, len(self.policy.objectives)).numpy()
        others = self.space.spread(bodies - 1, seed)
        designs = np.concatenate([self.space.default[None], others])
        return self.simulate(designs.repeat(tradeoffs, 0), np.tile(points, (bodies, 1)))

    def refine(self, known: Simulated, rounds: int, population: int, seed: int) -> Simulated:
        """Improve the front of known policies by so many generations of NSGA-II (Optuna's).

        Returns what was simulated.
        """
        objectives, m = self.policy.objectives, len(self.policy.objectives)
        number = optuna.distributions.FloatDistribution
        ranges: dict[str, optuna.distributions.BaseDistribution] = {
            name: number(each.low, each.high) for name, each in self.space.parameters.items()
        }
        ranges |= {f"weight of {name}": number(0.0, 1.0) for name in objectives}
        sampler = optuna.samplers.NSGAIISampler(population_size=population, seed=seed)
        with quiet():
            maximize = optuna.study.StudyDirection.MAXIMIZE
            study = optuna.create_study(directions=[maximize] * m, sampler=sampler)
            for row in best_first(known.returns)[:population]:
                numbers = [*known.designs[row], *known.tradeoffs[row]]
                study.enqueue_trial(dict(zip(ranges, map(float, numbers), strict=True)))
        found = known.rows(np.zeros(0, dtype=int))
        for _ in range(rounds):
            with quiet():
                trials = [study.ask(ranges) for _ in range(population)]
            drawn = np.array([[trial.params[name] for name in ranges] for trial in trials])
            designs, weights = drawn[:, :-m], drawn[:, -m:].clip(min=1e-6)
            new = self.simulate(designs, weights / weights.sum(1, keepdims=True))
            with quiet():
                for trial, returns in zip(trials, new.returns, strict=True):
                    if np.isfinite(returns).all():
                        study.tell(trial, returns.tolist())
                    else:
                        study.tell(trial, state=optuna.trial.TrialState.FAIL)
            found = found.joined(new)
        return found

    def hypervolume(self, simulated: Simulated) -> float:
        returns = simulated.returns
        return pareto.hypervolume(returns[np.isfinite(returns).all(1)], self.reference_point)

    def best_body(self, grid: Simulated, tradeoffs: int) -> tuple[np.ndarray, float]:
        """Return the design (d,) whose own front has the largest hypervolume, and that."""
        bodies = np.arange(len(grid.designs)).reshape(-1, tradeoffs)
        volumes = [self.hypervolume(grid.rows(rows)) for rows in bodies]
        best = int(np.argmax(volumes))
        return grid.designs[bodies[best, 0]], volumes[best]

    def choose(
        self,
        simulated: Simulated,
        at_least: Mapping[str, float],
        at_most: Mapping[str, float],
        maximize: str,
    ) -> int:
        """Return which of the simulated policies keeps requirements and has most of one value.

        Raises:
            MorlaxError: none keeps them, or a name is unknown.
        """
        names = Names(self.policy.objectives, self.quantities, self.policy.config.env)
        required = Requirements.of(names, at_least, at_most, maximize)
        best = required.best(simulated.values)
        if best is None:
            finite = required.finite(simulated.values)
            values = simulated.values[finite]
            scaled = required.with_margin(0.0, values)
            raise scaled.missed(simulated.tradeoffs[finite], values, "simulated")
        return best


def best_first(returns: np.ndarray) -> np.ndarray:
    """Order rows of returns (n, m): first the non-dominated ones, then those of the rest, ..."""
    left, found = np.flatnonzero(np.isfinite(returns).all(1)), []
    while len(left):
        front = pareto.non_dominated(returns[left])
        found.append(left[front])
        left = left[~front]
    return np.concatenate(found) if found else left
