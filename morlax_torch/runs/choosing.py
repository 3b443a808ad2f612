"""Choose a trade-off whose policy keeps requirements in simulation."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from scipy.special import log_ndtr

from ..configuration.tradeoffs import even_tradeoffs
from ..envs import MorlaxError, TaskOptions, get, resolve_device
from ..evaluation.evaluator import Evaluator, evaluation_worlds
from ..evaluation.front import Front
from ..evaluation.requirements import Choice, Requirements
from ..host.files import AnyPath
from ..host.phases import phase
from ..networks.policy import Policy
from .loading import load, load_front

BATCH = 64  # trade-offs that are simulated together
MOST_BATCHES = 32
SETTLED = 0.05  # chance of a gain below which nothing more is simulated
FINALISTS, MOST_GROUPS = 8, 4  # simulated again on other episodes, if the task is random
RANDOM_SEEDS = 8  # episodes per trade-off of a random task, at least
RANDOM_MARGIN = 0.02

# proposals
NEIGHBORS = 8  # of each trade-off, if there are more than two objectives
FRACTIONS = np.linspace(0, 1, 20, endpoint=False)[1:, None]  # between two neighbors
DECIMALS = 5  # of weights; what is simulated can be printed
ERROR = 0.005  # of an evaluated value: least standard error, as a share of the range
LEAST_ERROR = 1e-6  # of one interpolated between simulated ones, likewise
GAIN = 0.005  # improvement that is worth a simulation, likewise
UNCONSTRAINED = 4  # candidates of the first batch that ignore the requirements, to know their cost

# other conditions
EPISODES = 32
USUAL = "as in evaluations"
# changes of `task.randomization`, on top of the task's own
CONDITIONS: dict[str, dict[str, Any]] = {
    "other starts": {},
    "pushes of 0.5 m/s": {"push": 0.5, "push_every": 100},
    "friction times 0.5 to 1.5": {"friction": (0.5, 1.5)},
    "masses times 0.8 to 1.2": {"mass": (0.8, 1.2)},
    "motors times 0.8 to 1.2": {"strength": (0.8, 1.2)},
}
STARTS = 0.01  # least spread of starts, so that episodes differ


def choose(
    run: AnyPath | Policy | Front,
    constraints: Mapping[str, float],
    maximize: str,
    *,
    at_most: Mapping[str, float] | None = None,
    margin: float | None = None,
    seeds: int | None = None,
    seed: int = 0,
    device: str | None = None,
) -> Choice:
    """Return the trade-off that maximizes one value while others keep requirements.

    A value is the return of an objective, counted by the run's `evaluation.protocol`, or a quantity
    that evaluations of the task measure, such as "power (W)". A quantity may be named without its
    unit.

    Simulates evaluated trade-offs and others between them, and returns the best that keeps every
    requirement in simulation. If the task is random, more episodes decide among the best ones.

    Args:
        run: a run's folder, a checkpoint file, a shipped name, or a policy, which is moved to the
            device. Of a `Front`, or of a run on a CPU whose task needs a GPU, nothing is simulated:
            the best evaluated trade-off is returned.
        constraints: least value by name.
        maximize: name of a value.
        at_most: largest value by name.
        margin: share of a value's range by which its requirement must be exceeded. The range is
            that of the evaluated values. None: 0.02 if the task is random, otherwise 0.
        seeds: episodes per trade-off to average over. None: as in training, but at least 8 if the
            task is random.
        seed: random seed of the worlds, if the task is random.
        device: "cuda", "cpu", ...; None selects CUDA if there is a GPU.

    Raises:
        MorlaxError: there is no such run or value, a name is ambiguous, a number is out of range,
            or no policy keeps the requirements.
    """
    if isinstance(run, Front):
        return Chooser(None, run, seeds).choose(constraints, maximize, at_most, margin)
    torch_device = resolve_device(device)
    front = None if isinstance(run, Policy) else load_front(run)
    policy = (run if isinstance(run, Policy) else load(run, torch_device)).to(torch_device)
    return Chooser(policy, front, seeds, seed).choose(constraints, maximize, at_most, margin)


class Chooser:
    """Chooses trade-offs by simulation, or from a front without a policy or a GPU it needs."""

    def __init__(
        self, policy: Policy | None, front: Front | None, seeds: int | None = None, seed: int = 0
    ):
        self._front, self._seed = front, seed
        self._random = policy is not None and policy.config.task.for_evaluation().varies
        self._falls: dict[tuple[float, ...], float] = {}  # by trade-off, in its last episodes
        self._evaluator: Evaluator | None = None
        needs_gpu = policy is not None and get(policy.config.env).needs_gpu
        if front is not None and (policy is None or (needs_gpu and policy.device.type == "cpu")):
            if seeds is not None:
                reason = "of a Front alone" if policy is None else "without a GPU"
                raise MorlaxError(f"nothing is simulated {reason}: leave seeds out.")
            self._names = front.objectives, front.quantity_names
            self._remember(front.tradeoffs, front)
        elif policy is not None:
            self._evaluator = simulator(policy, BATCH, seeds, seed)
            self._evaluator.compile()
            self._names = policy.objectives, self._evaluator.env.quantities

    def choose(
        self,
        constraints: Mapping[str, float],
        maximize: str,
        at_most: Mapping[str, float] | None = None,
        margin: float | None = None,
    ) -> Choice:
        """Simulate until a gain is unlikely, and return the best; see `choose` of this module."""
        required = Requirements.of(*self._names, constraints, maximize, at_most or {})
        if margin is None:
            margin = RANDOM_MARGIN if self._random else 0.0
        candidates = Candidates(*self._start(required), required, margin)
        for batch in range(MOST_BATCHES):
            if self._evaluator is None:
                break
            proposed, promised, chance = candidates.propose(BATCH)
            if len(proposed) == 0 or (batch > 0 and chance < SETTLED):
                break
            candidates.tell(proposed, promised, self._simulate(self._evaluator, proposed))
        best, values, most = self._best(candidates)
        tradeoff, promised = candidates.tradeoffs[best].tolist(), candidates.promised[best]
        m = len(required.objectives)
        return Choice(
            tuple(tradeoff),
            returns=dict(zip(required.objectives, values[:m].tolist(), strict=True)),
            promised=dict(zip(required.objectives, promised[:m].tolist(), strict=True)),
            margins=required.margins(values),
            cost=max(0.0, most - float(values[required.maximized])),
            simulated=int(candidates.final.sum()) if self._evaluator else 0,
            quantities=dict(zip(required.quantities, values[m:].tolist(), strict=True)),
            falls=self._falls.get(tuple(tradeoff), 0.0),
            required=required,
        )

    def _start(self, required: Requirements) -> tuple[np.ndarray, np.ndarray, bool]:
        """Return trade-offs (n, m), values (n, m + q), and whether these may be chosen."""
        if (front := self._front) is not None:
            names = (*front.objectives, *front.quantity_names)
            columns = dict(zip(names, front.values.T, strict=True))
            lacking = np.full(len(front.returns), np.nan)
            values = np.stack([columns.get(name, lacking) for name in required.names], 1)
            if self._evaluator is None:
                return front.tradeoffs, values, True
            if required.finite(values).any():
                return rounded(front.tradeoffs), values, False
        assert self._evaluator is not None
        even = rounded(even_tradeoffs(BATCH, len(required.objectives)).double().numpy())
        return even, self._simulate(self._evaluator, even), True

    def _best(self, candidates: "Candidates") -> tuple[int, np.ndarray, float]:
        """Return the best candidate, its values (m + q,), and the most without requirements."""
        source = "simulated" if self._evaluator else "evaluated"
        ranked, required, values = candidates.ranked(source), candidates.required, candidates.values
        most = np.where(candidates.final, values[:, required.maximized], -np.inf)
        free = int(np.where(np.isfinite(most), most, -np.inf).argmax())
        if not self._random or self._evaluator is None:
            return int(ranked[0]), values[ranked[0]], float(values[free, required.maximized])
        agent, env, protocol = self._evaluator.agent, self._evaluator.env, self._evaluator.protocol
        points = torch.ones(FINALISTS, len(required.objectives), dtype=torch.float32, device="cpu")
        seeds = env.num_worlds // FINALISTS
        evaluator = Evaluator(agent, env, points, protocol, self._seed ^ 1, seeds, alone=True)
        evaluator.compile()
        finalists, values = np.empty(0, dtype=int), np.empty((0, len(required.names)))
        ranked = ranked[spread(len(ranked), MOST_GROUPS * (FINALISTS - 1))]
        for first in range(0, len(ranked), FINALISTS - 1):
            group = np.append(ranked[first : first + FINALISTS - 1], free)
            again = self._simulate(evaluator, candidates.tradeoffs[group])
            finalists, values = np.append(finalists, group), np.vstack([values, again])
            if required.kept(values).any():
                break
        best = required.ranked(candidates.tradeoffs[finalists], values, source)[0]
        return int(finalists[best]), values[best], float(values[-1, required.maximized])

    def _simulate(self, evaluator: Evaluator, tradeoffs: np.ndarray) -> np.ndarray:
        """Return the values (n, m + q) of at most as many trade-offs (n, m) as an evaluator has."""
        repeated = np.resize(tradeoffs, (evaluator.number, tradeoffs.shape[1]))
        evaluator.retarget(torch.from_numpy(repeated).float())
        front = evaluator.evaluate()
        self._remember(tradeoffs, front)
        return front.values[: len(tradeoffs)]

    def _remember(self, tradeoffs: np.ndarray, front: Front) -> None:
        rows = zip(map(tuple, tradeoffs.tolist()), front.falls.tolist(), strict=False)
        self._falls |= dict(rows)


def spread(number: int, most: int) -> np.ndarray:
    """Return ranks to simulate again: the best were lucky, and so are their neighbors.

    From 0, the best, they are ever further apart up to the last, at most `most` of a `number`.
    """
    return np.unique(np.geomspace(1, number, most).round().astype(int)) - 1


class Candidates:
    """Trade-offs (K, m) with known values (K, m + q), and the ones between them.

    Values of a trade-off that was not simulated (not `final`) are promises: evaluated, or
    interpolated between two neighbors. They are wrong by about as much as neighbors differ. A
    candidate's score is the probability that it keeps every requirement and gains on the best
    simulated one, if errors are independent and normal (constrained probability of improvement, as
    in Bayesian optimization). A trade-off whose values are not finite is passed over.
    """

    def __init__(
        self,
        tradeoffs: np.ndarray,
        values: np.ndarray,
        final: bool,
        required: Requirements,
        margin: float = 0.0,
    ):
        self._span = required.span(values)
        self.required = required.with_margin(margin, self._span)
        self.tradeoffs, first = np.unique(tradeoffs, axis=0, return_index=True)
        self.values = values[first].astype(float)
        self.promised = self.values.copy()  # (n, m + q)
        self.final = np.full(len(first), final)  # (n,)

    def tell(self, tradeoffs: np.ndarray, promised: np.ndarray, values: np.ndarray) -> None:
        """Add simulated values (n, m + q) of proposed trade-offs (n, m)."""
        others = ~(self.tradeoffs[:, None] == tradeoffs).all(2).any(1)
        self.tradeoffs = np.vstack([self.tradeoffs[others], tradeoffs])
        self.promised = np.vstack([self.promised[others], promised])
        self.values = np.vstack([self.values[others], values])
        self.final = np.append(self.final[others], np.ones(len(tradeoffs), bool))

    def propose(self, number: int) -> tuple[np.ndarray, np.ndarray, float]:
        """Return up to `number` trade-offs (n, m), promises (n, m + q) and the best's chance."""
        tradeoffs, promised, errors = self._pool()
        scores = self._scores(promised, errors)
        order = (-scores).argsort(kind="stable")
        if not self.final.any():
            freely = (-promised[:, self.required.maximized]).argsort(kind="stable")
            order = np.concatenate([freely[:UNCONSTRAINED], order])
        _, first = np.unique(tradeoffs[order], axis=0, return_index=True)
        best = order[np.sort(first)[:number]]
        return tradeoffs[best], promised[best], float(np.exp(scores.max(initial=-np.inf)))

    def ranked(self, source: str = "simulated") -> np.ndarray:
        """Return which final trade-offs keep the requirements, best first."""
        rows = self.final.nonzero()[0]
        return rows[self.required.ranked(self.tradeoffs[rows], self.values[rows], source)]

    def _pool(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return trade-offs to simulate (n, m), promises and standard errors (n, m + q)."""
        finite = self.required.finite(self.values)
        tradeoffs, final = self.tradeoffs[finite], self.final[finite]
        values = self.required.relevant(self.values[finite])
        one, other = _neighbors(tradeoffs)
        steps = values[other] - values[one]
        ends, differences = np.concatenate([one, other]), np.zeros_like(values)
        np.add.at(differences, ends, np.abs(np.tile(steps, (2, 1))))
        pairs = np.bincount(ends, minlength=len(values))
        rough = differences / pairs.clip(min=1)[:, None]  # (n, m + q) mean difference to neighbors
        unsure = np.where(final[:, None], LEAST_ERROR, ERROR) * self._span

        # trade-offs with equal values share a policy, and so do those between them
        _, different = np.unique(values, axis=0, return_index=True)
        alone = different[~final[different]]
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
        new = ~(proposed[:, None] == self.tradeoffs[self.final]).all(2).any(1)
        return proposed[new], promised[new], errors[new]

    def _scores(self, promised: np.ndarray, errors: np.ndarray) -> np.ndarray:
        """Return log probabilities (...) of promises and standard errors (..., m + q)."""
        required = self.required
        score = log_ndtr(required.excess(promised) / errors[..., required.limited]).sum(-1)
        rivals = required.kept(self.values) & (self.final | ~self.final.any())
        if rivals.any():
            index = required.maximized
            best = self.values[rivals, index].max() + GAIN * self._span[index]
            score = score + log_ndtr((promised[..., index] - best) / errors[..., index])
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


class Trial(NamedTuple):
    """Means over the episodes of one trade-off."""

    values: np.ndarray  # (m + q,) returns by objective, then measured quantities
    falls: float  # share of episodes that failed
    episodes: int


def trials(policy: Policy, tradeoff: Sequence[float], seed: int = 0) -> dict[str, Trial]:
    """Simulate a trade-off (m,) under the conditions that its task can vary, by name."""
    task = policy.config.task.for_evaluation()
    tasks = {USUAL: task}
    if isinstance(task, TaskOptions):
        for name, changes in CONDITIONS.items():
            varied = task.randomization.model_copy(update=changes)
            update = {"randomization": varied, "reset_noise": max(task.reset_noise, STARTS)}
            tasks[name] = task.model_copy(update=update)
    results: dict[str, Trial] = {}
    for number, (name, options) in enumerate(tasks.items()):
        phase("trying other conditions", number / len(tasks))
        config = policy.config.model_copy(update={"task": options})
        episodes = EPISODES if options.varies else 1
        try:
            changed = Policy(policy.agent, config, policy.objectives)
            evaluator = simulator(changed, 1, episodes, seed)
            evaluator.retarget(torch.from_numpy(np.array([tradeoff], np.float32)))
            front = evaluator.evaluate()
        except MorlaxError:  # worlds of this task cannot differ in this
            if name == USUAL:
                raise
            continue
        results[name] = Trial(front.values[0], float(front.falls[0]), episodes)
    return results


def simulator(
    policy: Policy, tradeoffs: int, seeds: int | None, seed: int, alone: bool = True
) -> Evaluator:
    """Make an evaluator of so many trade-offs, to `retarget`; see `choose`."""
    if seeds is None:
        varies = policy.config.task.for_evaluation().varies
        seeds = max(policy.config.evaluation.seeds, RANDOM_SEEDS) if varies else 1
    config = policy.config.model_copy(update={"device": str(policy.device), "backend": None})
    env = evaluation_worlds(config, tradeoffs, seeds, seed)
    # others follow
    points = torch.ones(tradeoffs, len(policy.objectives), dtype=torch.float32, device="cpu")
    protocol = config.evaluation.protocol
    return Evaluator(policy.agent, env, points, protocol, seed, seeds, alone=alone)
