"""Choose a trade-off whose policy keeps requirements in simulation."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import torch

from ..configuration.tradeoffs import even_tradeoffs
from ..envs import MorlaxError, get, resolve_device
from ..evaluation.candidates import Candidates, rounded
from ..evaluation.evaluator import Evaluator
from ..evaluation.front import Front
from ..evaluation.making import evaluation_worlds
from ..evaluation.names import Names
from ..evaluation.requirements import Choice, Requirements
from ..host.files import AnyPath
from ..networks.policy import Policy
from .loading import load, load_front

BATCH = 64  # trade-offs that are simulated together
MOST_BATCHES = 32
SETTLED = 0.05  # chance of a gain below which nothing more is simulated
FINALISTS, MOST_GROUPS = 8, 4  # simulated again on other episodes, if the task is random
RANDOM_SEEDS = 8  # episodes per trade-off of a random task, at least
RANDOM_MARGIN = 0.02
NOTHING: Mapping[str, float] = MappingProxyType({})


def choose(
    run: AnyPath | Policy | Front,
    constraints: Mapping[str, float],
    maximize: str,
    *,
    at_most: Mapping[str, float] = NOTHING,
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
    requirement in simulation. If the task is random, the best ones are simulated again on other
    episodes, more of them, and these decide.

    Args:
        run: a run's folder, a checkpoint file, a shipped name, or a policy, which is moved to the
            device. Of a `Front`, evaluated trade-offs are returned, and nothing is simulated; so,
            too, of a run on a CPU whose task needs a GPU.
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
        return Evaluated(run).choose(constraints, maximize, at_most, margin)
    place = resolve_device(device)
    front = None if isinstance(run, Policy) else load_front(run)
    policy = (run if isinstance(run, Policy) else load(run, place)).to(place)
    return chooser(policy, front, seeds, seed).choose(constraints, maximize, at_most, margin)


def chooser(
    policy: Policy, front: Front | None = None, seeds: int | None = None, seed: int = 0
) -> "Evaluated | Simulated":
    """Return what chooses: only of a front if the task needs a GPU and the policy is on a CPU.

    Raises:
        MorlaxError: `seeds` is given, and nothing is simulated.
    """
    on_cpu = policy.agent.observation_normalizer.mean.device.type == "cpu"
    if front is not None and on_cpu and get(policy.config.env).needs_gpu:
        if seeds is not None:
            raise MorlaxError(
                f"{policy.config.env} is only simulated on a GPU, so seeds has no effect here: "
                "leave it out."
            )
        varies = policy.config.task.for_evaluation().varies
        return Evaluated(front, RANDOM_MARGIN if varies else 0.0)
    return Simulated(policy, front, seeds, seed)


class Evaluated(NamedTuple):
    """Chooses among the evaluated trade-offs of a front."""

    front: Front
    margin: float = 0.0  # unless told otherwise

    def choose(
        self,
        constraints: Mapping[str, float],
        maximize: str,
        at_most: Mapping[str, float] = NOTHING,
        margin: float | None = None,
    ) -> Choice:
        front = self.front
        names = Names(front.objectives, front.quantity_names)
        required = Requirements.of(names, constraints, at_most, maximize)
        finite = required.finite(front.values)
        if not finite.any():
            raise required.missed(front.tradeoffs, front.values, "evaluated")
        tradeoffs, values = front.tradeoffs[finite], front.values[finite]
        required = required.with_margin(self.margin if margin is None else margin, values)
        best, most = required.best(values), float(values[:, required.maximized].max())
        if best is None:
            raise required.missed(tradeoffs, values, "evaluated")
        choice = required.choice(tradeoffs[best], values[best], values[best], most, 0)
        falls = 0.0 if front.falls is None else float(front.falls[finite][best])
        return choice._replace(falls=falls)


class Simulated:
    """Chooses trade-offs of a policy by simulation on its device.

    It starts from an evaluated front; without one, or if the front lacks a required quantity, it
    simulates some trade-offs first.
    """

    def __init__(
        self, policy: Policy, front: Front | None = None, seeds: int | None = None, seed: int = 0
    ):
        self._policy, self._seed = policy, seed
        self._random = policy.config.task.for_evaluation().varies
        usual = max(policy.config.evaluation.seeds, RANDOM_SEEDS) if self._random else 1
        self._seeds = usual if seeds is None else seeds
        place = str(policy.agent.observation_normalizer.mean.device)
        config = policy.config.model_copy(update={"device": place, "backend": None})
        self._env = evaluation_worlds(config, BATCH, self._seeds, seed)
        self._evaluator = self._make_evaluator(BATCH, seed)
        self._front = front
        self._names = Names(policy.objectives, self._env.quantities, policy.config.env)
        self._even: tuple[np.ndarray, np.ndarray] | None = None
        self._falls: dict[tuple[float, ...], float] = {}  # by trade-off, in its last simulation

    def choose(
        self,
        constraints: Mapping[str, float],
        maximize: str,
        at_most: Mapping[str, float] = NOTHING,
        margin: float | None = None,
    ) -> Choice:
        if margin is None:
            margin = RANDOM_MARGIN if self._random else 0.0
        required = Requirements.of(self._names, constraints, at_most, maximize)
        tradeoffs, values, simulated = self._start(required)
        known = values[required.finite(values)]
        if len(known) == 0:
            raise required.missed(tradeoffs, values, "simulated")
        required = required.with_margin(margin, known)
        found = Candidates(tradeoffs, values, simulated, required)
        for batch in range(MOST_BATCHES):
            proposed, promised, chance = found.propose(BATCH)
            if len(proposed) == 0 or (batch > 0 and chance < SETTLED):
                break
            found.tell(proposed, promised, self._simulate(self._evaluator, proposed))
        choice = self._best(found, required)
        return choice._replace(falls=self._falls[choice.tradeoff])

    def _best(self, found: Candidates, required: Requirements) -> Choice:
        """Return the best simulated trade-off that keeps the requirements.

        Of a random task, those that a few episodes show as the best are also the luckiest, so
        other episodes decide.
        """
        ranked, free = found.ranked(), found.unconstrained()
        simulated = int(found.simulated.sum())
        if not self._random:
            best = ranked[0]
            most = float(found.values[free, required.maximized])
            row = found.tradeoffs[best], found.values[best], found.promised[best]
            return required.choice(*row, most, simulated)
        evaluator = self._make_evaluator(FINALISTS, self._seed + 1)
        groups = [ranked[i : i + FINALISTS - 1] for i in range(0, len(ranked), FINALISTS - 1)]
        tried = np.empty(0, dtype=int)
        values = np.empty((0, len(self._names.all)))
        for group in groups[:MOST_GROUPS]:
            finalists = np.append(group, free)
            again = self._simulate(evaluator, found.tradeoffs[finalists])
            tried, values = np.append(tried, finalists), np.vstack([values, again])
            if (best := required.best(values)) is not None:
                row = found.tradeoffs[tried[best]], values[best], found.promised[tried[best]]
                most = float(values[-1, required.maximized])
                return required.choice(*row, most, simulated)
        raise required.missed(found.tradeoffs[tried], values, "simulated")

    def _start(self, required: Requirements) -> tuple[np.ndarray, np.ndarray, bool]:
        """Return trade-offs (n, m), values (n, m + q), and whether they were simulated here."""
        if self._front is not None:
            values = self._evaluated(self._front)
            if required.finite(values).any():
                return self._front.tradeoffs, values, False
        if self._even is None:
            even = rounded(even_tradeoffs(BATCH, len(self._names.objectives)).double().numpy())
            self._even = even, self._simulate(self._evaluator, even)
        return *self._even, True

    def _evaluated(self, front: Front) -> np.ndarray:
        """Return the values (K, m + q) of a front; NaN where it lacks a quantity of the task."""
        quantities = np.full((len(front.returns), len(self._names.quantities)), np.nan)
        for column, name in enumerate(self._names.quantities):
            if front.quantities is not None and name in front.quantity_names:
                quantities[:, column] = front.quantities[:, front.quantity_names.index(name)]
        return np.hstack([front.returns, quantities])

    def _make_evaluator(self, tradeoffs: int, seed: int) -> Evaluator:
        """Evaluate so many trade-offs at once, each in an equal share of the worlds."""
        some = torch.ones(tradeoffs, len(self._policy.objectives), dtype=torch.float32)
        seeds = self._env.num_worlds // tradeoffs
        protocol = self._policy.config.evaluation.protocol
        made = Evaluator(self._policy.agent, self._env, some, protocol, seed, seeds, alone=True)
        made.compile()
        return made

    def _simulate(self, evaluator: Evaluator, tradeoffs: np.ndarray) -> np.ndarray:
        """Return the values (n, m + q) of at most as many trade-offs (n, m) as an evaluator has."""
        filled = np.resize(tradeoffs, (evaluator.number, tradeoffs.shape[1]))  # repeats them
        evaluator.retarget(torch.from_numpy(filled).float())
        front = evaluator.evaluate()
        assert front.falls is not None
        self._falls |= dict(zip(map(tuple, tradeoffs.tolist()), front.falls.tolist(), strict=False))
        return front.values[: len(tradeoffs)]
