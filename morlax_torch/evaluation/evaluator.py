"""Evaluate a family of policies: one episode for each of a fixed set of trade-offs."""

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor

from ..configuration.config import Config
from ..configuration.sections import Protocol
from ..configuration.tradeoffs import dirichlet_tradeoffs, evaluation_tradeoffs
from ..envs import Environment, MorlaxError, Worlds, resolve_device
from ..envs.devices import EVALUATION_SEEDS, drawing_from
from ..envs.worlds.design_space import DesignSpace, compile_bank
from ..gpu.graph import Graph
from ..gpu.group import ALONE, Group
from ..host.phases import phase
from ..host.resources import one_thread
from ..networks.agent import Agent
from . import pareto
from .front import Front

DISCOUNT, HORIZON, REFERENCE = 0.99, 500, -100.0  # of the protocol "discounted"
SETS = 2  # of episodes where a task is random: one is reported, one chooses checkpoints
HELD_OUT = 2**62  # seed of the designs to evaluate with, which no training has
DRAWN_TRADEOFFS = 1024  # of the paper's tables, and of D3PO's
ESTIMATED = 32  # trade-offs of an estimate, the corners among them; more would take too long
STEPS_PER_GRAPH = 5  # at most: more need fewer launches, but take longer to record


def share(tradeoffs: Tensor, episodes: int, group: Group) -> Tensor:
    """Return the trade-off of each world (N, m) of this process."""
    return tradeoffs.repeat(episodes, 1)[group.rank :: group.size]


def stride_of(horizon: int) -> int:
    """Return the control steps between two changes of a trade-off over time."""
    return next(number for number in range(STEPS_PER_GRAPH, 0, -1) if horizon % number == 0)


class Evaluator:
    """Runs the deterministic policies of K trade-offs, each in its own worlds, for one episode.

    Every evaluation repeats the same random draws, so that an unchanged policy gets an unchanged
    front: bit for bit on the CPU, on CUDA up to the order of floating-point sums. The k-th episode
    of every trade-off has the same draws, except where a library draws for all worlds at once.

    docs/evaluation.md defines the protocols: `latched`, `paper`, of the paper's tables, and
    `discounted`, of C-MORL (ICLR 2025) and D3PO (arXiv 2602.07764) on MO-Gymnasium's tasks.

    The agent is read anew at each evaluation. There are K * seeds * sets worlds without automatic
    reset, in all processes of the group, which all get all results.

    Args:
        tradeoffs: (K, m), or conditions (K, m + d) if bodies differ, which the worlds have already.
        seeds: episodes per trade-off and set, to average over.
        alone: generate the networks of each trade-off on their own, as `Policy` does. Together is
            faster, but rounds differently, and robots amplify that.
    """

    def __init__(
        self,
        agent: Agent,
        env: Worlds,
        tradeoffs: Tensor,
        protocol: Protocol = "latched",
        seed: int = 0,
        seeds: int = 1,
        sets: int = 1,
        group: Group = ALONE,
        alone: bool = False,
    ):
        self._points, self._seeds = tradeoffs.repeat(seeds, 1).cpu().numpy(), seeds
        self._sets, self._alone, self.number = sets, alone, len(tradeoffs)  # K
        tradeoffs = share(tradeoffs, seeds * sets, group)
        if env.auto_reset or env.num_worlds != len(tradeoffs):
            raise ValueError("an evaluator needs a world per episode, and auto_reset=False")
        agent.check_sizes(env)
        # common random numbers: a trade-off's k-th episode draws what that of another one draws
        episodes = torch.arange(len(self._points) * sets, device="cpu") // self.number
        env.share_draws(episodes[group.rank :: group.size], SETS * seeds)
        self.agent, self.env, self._group = agent, env, group
        self.protocol: Protocol = protocol
        self.tradeoffs = tradeoffs.to(env.device)
        self._seed = EVALUATION_SEEDS + int(seed)
        self._observation = env.reset().clone()
        self._alive = torch.ones(len(tradeoffs), dtype=torch.bool, device=env.device)
        self._knows_blowups = True
        m, size = len(env.objectives), env.measure().shape[1] + 1 if env.quantities else 0
        # a row of results per world
        shape = len(tradeoffs), m + size + 3
        self._results = torch.zeros(shape, dtype=torch.float32, device=env.device)
        self._returns = self._results[:, :m]
        self._measured = self._results[:, m:-3]  # sums, then the number of measured steps
        self._lengths, self._fallen, self._blown_up = self._results[:, -3:].T
        self._discounted = protocol == "discounted"
        self._weight = self._returns.new_ones(())  # of the next step's rewards
        self._horizon = min(HORIZON, env.episode_length) if self._discounted else env.episode_length
        with torch.no_grad(), torch.autocast(env.device.type, enabled=False):
            actors = agent.actors(self.tradeoffs)
        # a recorded graph reads parameters at fixed addresses
        parameters = {name: value.clone() for name, value in actors.parameters.items()}
        self._actors = actors._replace(parameters=parameters)
        self._stride = stride_of(self._horizon)
        self.duration = self._horizon * env.dt  # s of an episode, as far as its returns count
        self.period = self._stride * env.dt  # s between two changes of a trade-off over time
        self._steps = Graph(self._some_steps, env.device, [env.generator], self._one_step)

    def compile(self) -> None:
        """Compile kernels and record some steps; worlds that cannot be recorded run eagerly."""
        if self.env.recordable:
            self._steps.record()

    @property
    def reference_point(self) -> np.ndarray:
        """(m,), that hypervolumes by the protocol count from."""
        point = np.array(self.env.reference_point)
        return np.full_like(point, REFERENCE) if self._discounted else point

    def retarget(self, tradeoffs: Tensor) -> None:
        """Evaluate as many other trade-offs (K, m) from now on."""
        self._points = tradeoffs.repeat(self._seeds, 1).cpu().numpy()
        self.tradeoffs.copy_(share(tradeoffs, self._seeds * self._sets, self._group))

    def evaluate(self) -> Front:
        """Return the front of the first set of episodes."""
        return self.evaluate_sets()[0]

    def evaluate_sets(self) -> list[Front]:
        """Evaluate the agent as it is now, and return the front of each set of episodes."""
        self._generate()
        self._run()
        return self._fronts()

    def estimate(self, rates: np.ndarray) -> float:
        """Estimate the hypervolume roughly from training, without an episode.

        `rates` (K, m + 1) are mean rewards per control step of some trade-offs, and the share of
        steps that failed. A return adds them up until an episode ends, or fails at that rate.
        """
        rates = rates[-(ESTIMATED if rates.shape[1] < 10 else pareto.EXACT_POINTS_OF_MORE) :]
        lasting = (1 - rates[:, -1:]) * (DISCOUNT if self._discounted else 1.0)
        lost = np.maximum(1 - lasting, 1e-9)  # of a step's weight, from each to the next
        steps = (1 - (1 - lost) ** self._horizon) / lost
        return pareto.hypervolume(rates[:, :-1] * steps, self.reference_point)

    def follow(
        self, tradeoffs: Callable[[float], np.ndarray], windows: Sequence[tuple[float, float]]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Evaluate K trade-offs (K, m) that change with the seconds of an episode.

        Returns the values (W, K, m + q) of each window of time, whose start and end are rounded to
        a period, and the share of episodes that failed (K,). A quantity that was not measured in a
        window is NaN.
        """
        sums: list[Tensor] = []

        def change(step: int) -> None:
            sums.append(self._results.clone())
            self.retarget(torch.from_numpy(tradeoffs(step * self.env.dt)).float())
            self._generate()

        self._run(change)
        rows = torch.stack([*sums, self._results]).double().cpu().numpy()
        rows = rows.reshape(len(rows), self._seeds, self.number, -1)
        last = len(rows) - 1  # evaluations stop once every episode has ended
        (front,) = self._fronts()
        values = []
        for window in windows:
            start, end = (min(round(seconds / self.period), last) for seconds in window)
            end = max(end, min(start + 1, last))  # half periods round to even numbers
            values.append(self._values(rows[end] - rows[start]))
        return np.stack(values), front.falls

    @torch.no_grad()
    def _generate(self) -> None:
        size = 1 if self._alone else len(self.tradeoffs)
        with torch.autocast(self.env.device.type, enabled=False):  # that a user may have enabled
            for first in range(0, len(self.tradeoffs), size):
                part = slice(first, first + size)
                self._actors.copy_(self.agent.actors(self.tradeoffs[part]), part)

    @torch.no_grad()
    def _run(self, before: Callable[[int], None] = lambda step: None) -> None:
        """Run the episodes; `before` some steps, whose first is given, it may change networks."""
        generator = self.env.generator
        state = generator.get_state()  # which training worlds of another library may share
        self.env.reseed(self._seed)
        self._observation.copy_(self.env.reset())
        self._alive.fill_(True)
        self.env.move_only(self._alive)
        self._weight.fill_(1.0)
        self._results.zero_()
        if self.protocol == "paper":
            self._returns += self.env.paper_reset_reward()
        noun = "trade-off" if self.number == 1 else "trade-offs"
        # on a GPU, it would wait to know whether a further step counts
        may_end = self.env.device.type == "cpu" and self.protocol != "paper"
        with one_thread(self.env.device):
            for step in range(0, self._horizon, self._stride):
                phase(f"evaluating {self.number} {noun}", step / self._horizon)
                before(step)
                self._steps()
                if may_end and not self._alive.any():
                    break
        generator.set_state(state)

    def _fronts(self) -> list[Front]:
        """Copy the results to the CPU, all at once because each copy waits for the GPU."""
        overflow = self.env.overflow()[:, None]
        results = torch.cat([self._results.double(), overflow.double()], 1).cpu().numpy()
        table = np.empty((self._sets * len(self._points), results.shape[1]))
        for rank, part in enumerate(self._group.gather(results)):
            table[rank :: self._group.size] = part
        if (overflow := table[:, -1]).any():
            remedy = self.env.remedy(int(overflow.max()))
            raise MorlaxError(f"contacts overflowed their buffers in an evaluation: {remedy}.")
        return [self._front(rows) for rows in np.split(table[:, :-1], self._sets)]

    def _front(self, rows: np.ndarray) -> Front:
        """Return the front of one set of episodes, a row of results each: their means."""
        m, episodes = len(self.env.objectives), rows.reshape(self._seeds, self.number, -1)
        means = episodes.mean(0)
        lengths, falls, blowups = means[:, -3:].T.copy()
        return Front(
            self.env.objectives,
            self._points[: self.number, :m].copy(),
            means[:, :m].copy(),
            lengths if self._seeds > 1 else lengths.astype(np.int32),
            self.reference_point,
            falls,
            blowups if self._knows_blowups else None,
            protocol=self.protocol,
            titles=tuple(self.env.titles.get(name, name) for name in self.env.objectives),
            quantities=self._quantities(episodes) if self.env.quantities else None,
            quantity_names=self.env.quantities,
        )

    def _values(self, sums: np.ndarray) -> np.ndarray:
        """Return values (K, m + q) of sums (seeds, K, columns) over a window of time."""
        returns = sums[..., : len(self.env.objectives)].mean(0)
        if not self.env.quantities:
            return returns
        measured = sums[..., -4].sum(0)[:, None] > 0
        return np.hstack([returns, np.where(measured, self._quantities(sums), np.nan)])

    def _quantities(self, sums: np.ndarray) -> np.ndarray:
        *measured, steps = sums[..., len(self.env.objectives) : -3].sum(0).T
        lengths, falls, _ = sums[..., -3:].mean(0).T
        return self.env.quantify((np.stack(measured) / steps.clip(1)).T, falls / lengths.clip(1))

    def _some_steps(self) -> None:
        for _ in range(self._stride):
            self._one_step()

    @torch.no_grad()
    def _one_step(self) -> None:
        step = self.env.step(self._actors.act(self._observation[:, None])[:, 0])
        latched = self.protocol != "paper"
        counted = self._alive if latched else torch.ones_like(self._alive)
        self._fallen.logical_or_(step.terminated & counted)
        self._knows_blowups = step.blown_up is not None
        if step.blown_up is not None:
            self._blown_up.logical_or_(step.blown_up & counted)
        if not latched:
            self._alive.copy_(~step.terminated)
        self._returns += self._weight * torch.where(self._alive[:, None], step.reward, 0.0)
        if self._discounted:
            self._weight *= DISCOUNT
        self._lengths += self._alive
        over = step.terminated | step.truncated
        if self.env.quantities:  # after the last step of an episode, a new one may have begun
            sample = torch.cat([self.env.measure(), torch.ones_like(self._measured[:, :1])], 1)
            self._measured += torch.where((self._alive & ~over)[:, None], sample, 0.0)
        if latched:
            self._alive &= ~over
            self.env.move_only(self._alive)
        self._observation.copy_(step.observation)


def usual_tradeoffs(config: Config, protocol: Protocol) -> int:
    """Return the config's number of trade-offs, or that of published tables by their protocols."""
    of_config = protocol in ("latched", config.evaluation.protocol)
    return config.evaluation.tradeoffs if of_config else DRAWN_TRADEOFFS


def make_evaluator(
    agent: Agent,
    config: Config,
    protocol: Protocol | None = None,
    tradeoffs: int | None = None,
    seeds: int | None = None,
    seed: int = 0,
    sets: int = 1,
    group: Group = ALONE,
    bodies: int = 1,
) -> Evaluator:
    """Make the evaluator of an agent, with the same worlds for every training seed.

    With several `bodies`, that of the agent's context comes first, and fronts hold all trade-offs
    of one body after the other. What is None comes from the config.
    """
    protocol = config.evaluation.protocol if protocol is None else protocol
    config.check_protocol(protocol)
    tradeoffs = usual_tradeoffs(config, protocol) if tradeoffs is None else tradeoffs
    seeds = config.evaluation.seeds if seeds is None else seeds
    points = evaluation_tradeoffs(tradeoffs, len(agent.objectives))  # refuses too few
    if protocol != "latched":
        points = dirichlet_tradeoffs(tradeoffs, len(agent.objectives))
    # new worlds may seed torch's own generator, from which training worlds may draw
    with drawing_from(torch.Generator(resolve_device(config.device))):
        env = evaluation_worlds(config, tradeoffs * bodies, seeds, seed, sets, group)
        if bodies > 1:
            assert isinstance(env, Environment)
            points = points.repeat(bodies, 1)
            rows = torch.arange(bodies, device="cpu").repeat_interleave(tradeoffs)
            designs = held_out(env, bodies)
            if not embody(env, designs, share(rows[:, None], seeds * sets, group)[:, 0]).all():
                raise MorlaxError(f"not all of {bodies} designs to evaluate with make a body.")
            contexts = torch.from_numpy(DesignSpace(env.designs).scaled(designs)).float()
            points = torch.cat([points, contexts[rows]], -1)
        return Evaluator(agent, env, points, protocol, seed, seeds, sets, group)


def held_out(env: Environment, number: int) -> np.ndarray:
    """Return designs (number, d): first the one of the worlds, then others, spread evenly."""
    space = DesignSpace(env.designs)
    return np.vstack([space.vector(env.options.design), space.spread(number - 1, HELD_OUT)])


def embody(env: Environment, designs: np.ndarray, rows: Tensor) -> np.ndarray:
    """Give the worlds the bodies of designs (D, d) by row (N,), in new episodes.

    Returns which designs make a body, (D,) bool. Worlds of another one get any body.
    """
    bank = compile_bank(env, designs)
    env.adopt(bank)
    slots = torch.from_numpy((bank.kept.cumsum() - 1).clip(min=0)).to(env.device)  # in the bank
    everywhere = torch.ones_like(env.age, dtype=torch.bool)
    env.embody(slots[rows.to(env.device)], everywhere)
    return bank.kept


def evaluation_worlds(
    config: Config, tradeoffs: int, seeds: int, seed: int = 0, sets: int = 1, group: Group = ALONE
) -> Worlds:
    """Make this process's share of an evaluator's worlds, one per episode; see `make_evaluator`."""
    if not 0 <= seed < 2**63 or seed % 1:
        raise MorlaxError(f"seed is {seed}: it must be an integer from 0 to 2^63 - 1.")
    if seeds < 1:
        raise MorlaxError(f"seeds is {seeds}: at least one is needed.")
    try:
        config.task.check_seeds(seeds)
    except ValueError as error:
        raise MorlaxError(f"{error}: leave out --seeds.") from None
    if (episodes := tradeoffs * seeds * sets) < group.size:
        raise MorlaxError(
            f"an evaluation has {episodes} episodes, fewer than the {group.size} processes of this "
            "run: raise evaluation.tradeoffs, or start fewer processes."
        )
    number = len(range(group.rank, episodes, group.size))
    return config.make_worlds(number, EVALUATION_SEEDS + int(seed), evaluating=True)
