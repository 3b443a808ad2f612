"""Search over bodies and trade-offs together, of a family of policies that knows many bodies."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, Self

import moocore
import numpy as np
import torch

from ..configuration.config import Config
from ..configuration.tradeoffs import evaluation_tradeoffs
from ..envs import Environment, MorlaxError, get
from ..envs.worlds.design_space import DesignSpace, compiled
from ..evaluation import figures, pareto
from ..evaluation.evaluator import Evaluator, embody, evaluation_worlds
from ..host.files import write_file, write_rows
from ..host.phases import phase
from ..networks.policy import Policy
from ..runs.loading import save
from ..runs.references import copy_files
from .evolution import evolve

BATCH = {"cuda": 32_768, "cpu": 2048}  # policies that are simulated together


class Simulated(NamedTuple):
    """Policies by body and trade-off, with the values that they reached."""

    designs: np.ndarray  # (n, d)
    tradeoffs: np.ndarray  # (n, m)
    values: np.ndarray  # (n, m + q) returns, then quantities; NaN: the design makes no body

    def joined(self, other: Self) -> Self:
        return type(self)(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))

    def rows(self, which: np.ndarray | slice) -> Self:
        return type(self)(*(column[which] for column in self))

    @property
    def missing(self) -> int:
        """Number of policies whose design makes no body."""
        return int(np.isnan(self.returns).any(1).sum())

    @property
    def returns(self) -> np.ndarray:
        """(n, m)"""
        return self.values[:, : self.tradeoffs.shape[1]]


class Designer:
    """Simulates policies of any body and trade-off, on the policy's device."""

    def __init__(self, policy: Policy, seed: int = 0):
        if not len(policy.agent.context):
            raise MorlaxError(
                "these policies were trained with one body: train with --sampling.designs 1024, a "
                "task with design parameters (docs/designs.md)."
            )
        self.policy, self.space, self._seed = policy, DesignSpace(policy.agent.designs), seed
        self.quantities = get(policy.config.env).quantities
        self.reference_point = np.zeros(len(policy.objectives))

    def simulate(self, designs: np.ndarray, tradeoffs: np.ndarray) -> Simulated:
        """Simulate pairs of designs (n, d) and trade-offs (n, m), one episode or more of each."""
        device = self.policy.agent.context.device
        changes = {"device": str(device), "backend": None}
        config, parts = self.policy.config.model_copy(update=changes), []
        for first in range(0, len(designs), BATCH[device.type]):
            phase(f"simulating {len(designs)} bodies and trade-offs", first / len(designs))
            batch = slice(first, first + BATCH[device.type])
            parts.append(self._together(config, designs[batch], tradeoffs[batch]))
        return Simulated(designs, tradeoffs, np.concatenate(parts))

    def _together(self, config: Config, designs: np.ndarray, tradeoffs: np.ndarray) -> np.ndarray:
        seeds = config.evaluation.seeds
        env = evaluation_worlds(config, len(designs), seeds, self._seed)
        assert isinstance(env, Environment)
        different, rows = np.unique(designs, axis=0, return_inverse=True)
        rows = rows.reshape(-1)  # numpy 2.0 gives it another shape
        made = embody(env, different, torch.from_numpy(rows).repeat(seeds))
        conditions = np.concatenate([tradeoffs, self.space.scaled(designs)], 1)
        points, protocol = torch.from_numpy(conditions).float(), config.evaluation.protocol
        evaluator = Evaluator(self.policy.agent, env, points, protocol, self._seed, seeds)
        evaluator.compile()
        self.reference_point = evaluator.reference_point
        values = evaluator.evaluate().values.astype(float)
        values[~made[rows]] = np.nan
        return values

    def grid(self, bodies: int, tradeoffs: int) -> Simulated:
        """Simulate the default body and others, spread evenly, each with the same trade-offs."""
        points = evaluation_tradeoffs(tradeoffs, len(self.policy.objectives)).numpy()
        others = self.space.spread(bodies - 1, self._seed)
        designs = np.concatenate([self.space.default[None], others])
        return self.simulate(designs.repeat(tradeoffs, 0), np.tile(points, (bodies, 1)))

    def refine(self, start: Simulated, rounds: int, population: int) -> Simulated:
        """Return what generations of NSGA-II simulate, from the front of simulated policies."""
        m = len(self.policy.objectives)
        ranges = {name: (each.low, each.high) for name, each in self.space.parameters.items()}
        ranges |= {f"weight of {name}": (0.0, 1.0) for name in self.policy.objectives}
        finite = np.flatnonzero(np.isfinite(start.returns).all(1))
        ranks = moocore.pareto_rank(start.returns[finite], maximise=True)
        best = finite[ranks.argsort(kind="stable")]
        starts = np.hstack([start.designs[best], start.tradeoffs[best]])
        simulated = start.rows(np.zeros(0, dtype=int))

        def score(drawn: np.ndarray) -> np.ndarray:
            nonlocal simulated
            designs, weights = drawn[:, :-m], drawn[:, -m:].clip(min=1e-6)
            new = self.simulate(designs, weights / weights.sum(1, keepdims=True))
            simulated = simulated.joined(new)
            return new.returns

        evolve(ranges, starts, m, population, rounds, self._seed, score)
        return simulated

    def hypervolume(self, simulated: Simulated) -> float:
        returns = simulated.returns
        return pareto.hypervolume(returns[np.isfinite(returns).all(1)], self.reference_point)

    def best_body(self, grid: Simulated, tradeoffs: int) -> tuple[np.ndarray, float]:
        """Return the design (d,) whose own front has the largest hypervolume, and that."""
        bodies = np.arange(len(grid.designs)).reshape(-1, tradeoffs)
        volumes = [self.hypervolume(grid.rows(rows)) for rows in bodies]
        best = int(np.argmax(volumes))
        return grid.designs[bodies[best, 0]], volumes[best]

    def body(self, design: np.ndarray) -> str:
        """Return the parameters of a design (d,) as text."""
        parameters = zip(self.space.parameters.items(), design, strict=True)
        return ", ".join(f"{name} {value:.3g} {each.unit}" for (name, each), value in parameters)

    def reached(self, simulated: Simulated, row: int) -> str:
        """Return the values of a policy as text."""
        names = (*self.policy.objectives, *self.quantities)
        values = zip(names, simulated.values[row], strict=True)
        return ", ".join(f"{name} {value:.4g}" for name, value in values)

    def compared(
        self, default: Simulated, grid: Simulated, simulated: Simulated, best: float
    ) -> Iterator[tuple[str, ...]]:
        """Yield rows: a front, its hypervolume, and its numbers of policies and of bodies."""
        parts = {"default body": default, "bodies spread evenly": grid, "and refined": simulated}
        for name, part in parts.items():
            front = part.rows(pareto.non_dominated(part.returns))
            bodies = len(np.unique(front.designs, axis=0))
            yield name, f"{self.hypervolume(part):.4e}", str(len(front.values)), str(bodies)
            if part is default:
                yield "best body", f"{best:.4e}", "", "1"

    def extremes(self, simulated: Simulated) -> Iterator[str]:
        """Say which policy has most of each objective."""
        for index, name in enumerate(self.policy.objectives):
            row = int(np.nanargmax(simulated.returns[:, index]))
            body = self.body(simulated.designs[row])
            yield f"most {name}: {self.reached(simulated, row)}; {body}"

    def write(
        self, folder: Path, simulated: Simulated, default: Simulated, best: np.ndarray
    ) -> None:
        """Write the front of all bodies as a table and a figure, and the best body."""
        policy, parameters = self.policy, self.space.parameters
        weights = [f"weight of {name}" for name in policy.objectives]
        front = simulated.rows(pareto.non_dominated(simulated.returns))
        heads = [*parameters, *weights, *policy.objectives, *self.quantities]
        rows = ([f"{number:.6g}" for number in row] for row in np.hstack(front))
        write_rows(folder / "designs.csv", [heads, *rows])
        units = [f"{name} ({each.unit})" for name, each in parameters.items()]
        usual, titles = pareto.front(default.returns), get(policy.config.env).titles
        names = [titles.get(name, name) for name in policy.objectives]
        figure = figures.designs_figure(names, front.returns, front.designs, units, usual)
        figures.save(figure, folder / "designs")
        design = self.space.named(best)
        spec, _ = compiled(get(policy.config.env), design)
        write_file(folder / "body.xml", spec.to_xml())
        save(policy.for_design(design).cpu(), folder / "body.pt")
        copy_files(policy.config, folder)
