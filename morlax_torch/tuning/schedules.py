"""Search for a trade-off that changes over an episode, under requirements per window of time."""

from collections.abc import Mapping
from operator import itemgetter
from typing import NamedTuple, Self

import numpy as np

from ..configuration.schedules import Schedule
from ..envs import MorlaxError
from ..evaluation.front import Front
from ..evaluation.requirements import Requirements, index_of
from ..host.phases import within
from ..networks.policy import Policy
from ..runs.choosing import RANDOM_MARGIN, rounded, simulator, spread
from .evolution import evolve

POPULATION = 64  # trade-offs over time that are simulated together
ROUNDS = {"constant": 4, "over time": 20}  # generations, after the policies of the front
FINALISTS = 16  # simulated again in other episodes, if the task is random
LEVEL = itemgetter(1)  # of a name and its required value
BROKEN = 1e6  # lowers the score of a policy that misses a requirement by a value's whole range


class Simulated(NamedTuple):
    weights: np.ndarray  # (n, k, m) at the knots
    values: np.ndarray  # (n, v) returns and quantities of whole episodes, then of windows
    falls: np.ndarray  # (n,) share of episodes

    def rows(self, which: np.ndarray | slice) -> Self:
        return type(self)(*(column[which] for column in self))

    @classmethod
    def joined(cls, parts: "list[Simulated]") -> "Simulated":
        return cls(*map(np.concatenate, zip(*parts, strict=True)))


class Scheduler:
    """Finds trade-offs over time by NSGA-II, in simulation; `Choose` describes the arguments.

    Values are named as for `Chooser`; "run @ 3-5" is that of seconds 3 to 5 of an episode.
    """

    def __init__(
        self,
        policy: Policy,
        least: Mapping[str, float],
        maximize: str,
        most: Mapping[str, float],
        knots: int = 8,
        slew: float = 2.0,
        margin: float | None = None,
        seeds: int | None = None,
        seed: int = 0,
    ):
        self._policy, self._slew, self._seed = policy, slew, seed
        self._random = policy.config.task.for_evaluation().varies
        self._margin = (RANDOM_MARGIN if self._random else 0.0) if margin is None else margin
        self._open(POPULATION, seeds, seed)
        env, self._duration = self._evaluator.env, self._evaluator.duration
        if not np.isfinite(self._duration):
            raise MorlaxError(f"{policy.config.env} does not tell how long a control step takes.")
        if env.follows_part:
            raise MorlaxError(
                "the run's episodes are parts of its motion, or of several, but a trade-off over "
                "time follows the phase of one: train with one motion, and --task.episode-length, "
                "its control steps less one."
            )
        self._windows: dict[str, tuple[int, float, float]] = {}  # value, start, end by name
        # of a value that is named in two ways, the strictest requirement comes last
        rising, falling = sorted(least.items(), key=LEVEL), sorted(most.items(), key=LEVEL)[::-1]
        named = [{self._name(name): x for name, x in levels} for levels in (rising, falling)]
        maximize = self._name(maximize)
        names = policy.objectives, (*env.quantities, *self._windows)
        self.required = Requirements.of(*names, named[0], maximize, named[1])
        times = {0.0, self._duration}
        for _, start, end in self._windows.values():
            times |= {start - 1 / slew, start, end, end + 1 / slew}
        self._times = np.array([t for t in sorted(times) if 0 <= t <= self._duration])
        while len(self._times) < knots:
            gap = np.diff(self._times).argmax()
            self._times = np.insert(self._times, gap + 1, self._times[gap : gap + 2].mean())

    def search(self, front: Front) -> tuple[Schedule, dict[str, Simulated]]:
        """Return the best trade-off over time, or raise MorlaxError if none keeps the requirements.

        Beside it, return what it, the best constant one and the best of the front reach.
        """
        points = rounded(front.tradeoffs[front.non_dominated])[:, None]
        weights = points.repeat(len(self._times), 1)
        cuts = range(POPULATION, len(weights), POPULATION)
        with within("front"):
            policies = Simulated.joined([self._simulate(part) for part in np.split(weights, cuts)])
        self._span = self.required.span(policies.values)
        self.required = self.required.with_margin(self._margin, self._span)
        ranked = self._ranked(policies)
        constant = self._ranked(self._refined("constant", ranked.weights[:, :1]))
        moving = self._ranked(self._refined("over time", constant.weights))
        best = {"over time": moving, "constant": constant, "of the front": ranked}
        if self._random:
            self._open(FINALISTS, self._evaluator.env.num_worlds // FINALISTS, self._seed ^ 1)
            for name, each in best.items():
                number = max(int(self.required.kept(each.values).sum()), FINALISTS)
                ranks = spread(min(number, len(each.weights)), FINALISTS)
                best[name] = self._ranked(self._simulate(each.weights[ranks]))
            best["over time"] = self._ranked(Simulated.joined([*best.values()]))
        best = {name: each.rows(slice(1)) for name, each in best.items()}
        weights, (values,), _ = best["over time"]
        if not self.required.kept(values[None])[0]:
            raise MorlaxError(
                "no trade-off over time keeps every requirement: the nearest has "
                f"{self.required.misses(values)}."
            )
        names, limits = self.required.names, self.required.limits
        levels = [f"{names[limit.index]}: {limit.shown()}" for limit in limits]
        name = ", ".join([f"most {names[self.required.maximized]}", *levels])
        return Schedule(self._times, weights[0], name), best

    def _open(self, number: int, seeds: int | None, seed: int) -> None:
        # alone, so that a film repeats an episode exactly; slow for many episodes
        self._evaluator = simulator(self._policy, number, seeds, seed, alone=not self._random)
        self._evaluator.compile()

    def _name(self, value: str) -> str:
        """Return the full name of a value, and keep its window, if any."""
        short, _, window = (part.strip() for part in value.partition("@"))
        env = self._evaluator.env
        index = index_of(short, env.objectives, env.quantities)
        name = (*env.objectives, *env.quantities)[index]
        if not window:
            return name
        try:
            start, end = map(float, window.split("-"))
        except ValueError:
            start, end = 0.0, 0.0
        if not 0 <= start < end <= self._duration or end - start < self._evaluator.period:
            raise MorlaxError(
                f"the window {window!r} of {name} must lie in the episode, which ends after "
                f"{self._duration:g} s: write for example @ 0-{self._duration / 2:g}."
            )
        name = f"{name} @ {start:g}-{end:g} s"
        self._windows[name] = index, start, end
        return name

    def _limited(self, weights: np.ndarray) -> np.ndarray:
        """Scale weights (n, k, m) to trade-offs, and limit their changes from knot to knot."""
        weights = weights.clip(1e-6)
        weights /= weights.sum(2, keepdims=True)
        for knot, most in enumerate(self._slew * np.diff(self._times), 1):
            change = weights[:, knot] - weights[:, knot - 1]
            largest = np.abs(change).max(1, keepdims=True).clip(most)
            weights[:, knot] = weights[:, knot - 1] + change * most / largest
        return rounded(weights.reshape(-1, weights.shape[2])).reshape(weights.shape)

    def _simulate(self, weights: np.ndarray) -> Simulated:
        """Simulate at most as many trade-offs over time (n, k, m) as the evaluator has."""
        filled = np.resize(weights, (self._evaluator.number, *weights.shape[1:]))
        windows = [(0.0, self._duration), *(window[1:] for window in self._windows.values())]
        (whole, *parts), falls = self._evaluator.follow(Schedule(self._times, filled).at, windows)
        indices = [index for index, *_ in self._windows.values()]
        columns = [part[:, index] for part, index in zip(parts, indices, strict=True)]
        values = np.column_stack([whole, *columns])
        return Simulated(filled, values, falls).rows(slice(len(weights)))

    def _scores(self, values: np.ndarray) -> np.ndarray:
        """Return (n,) of values (n, v): the maximized one if all requirements are kept."""
        required, span = self.required, self._span
        missed = (required.excess(values) / span[required.limited]).clip(max=0).sum(1)
        scores = values[:, required.maximized] / span[required.maximized] + BROKEN * missed
        return np.where(required.finite(values), scores, -np.inf)

    def _ranked(self, simulated: Simulated) -> Simulated:
        return simulated.rows((-self._scores(simulated.values)).argsort(kind="stable"))

    def _refined(self, kind: str, starts: np.ndarray) -> Simulated:
        """Simulate generations of NSGA-II from weights (n, k, m); those of constant have k = 1."""
        _, k, m = starts.shape
        ranges = {f"weight {i}": (0.0, 1.0) for i in range(k * m)}
        generations: list[Simulated] = []

        def score(drawn: np.ndarray) -> np.ndarray:
            weights = drawn.reshape(-1, k, m).repeat(len(self._times) // k, 1)
            with within(f"{kind}, round {len(generations) + 1} of {ROUNDS[kind]}"):
                generations.append(self._simulate(self._limited(weights)))
            return self._scores(generations[-1].values).clip(-10 * BROKEN)[:, None]

        flat = starts.reshape(len(starts), -1)
        evolve(ranges, flat, 1, POPULATION, ROUNDS[kind], self._seed, score)
        return Simulated.joined(generations)
