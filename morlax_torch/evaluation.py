"""A fixed set of trade-offs, an episode each: the returns, and the front they make."""

from collections.abc import Iterable
from pathlib import Path
from typing import Literal, NamedTuple, Self

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from . import pareto
from .agent import Agent
from .envs import MorlaxError, Worlds
from .files import replacing
from .graph import Graph
from .rollout import one_thread

Protocol = Literal["latched", "paper"]
EXACT, APPROXIMATE = "hypervolume", "hypervolume_approximate"  # the indicator's name


class Front(NamedTuple):
    """What a family of policies reached."""

    objectives: tuple[str, ...]
    tradeoffs: np.ndarray  # (K, m)
    returns: np.ndarray  # (K, m) undiscounted sums
    lengths: np.ndarray  # (K,) control steps until the episode ended
    reference_point: np.ndarray  # (m,)
    falls: np.ndarray | None = None  # (K,) the share of episodes that failed; None: not known

    @property
    def non_dominated(self) -> np.ndarray:
        """(K,) bool"""
        return pareto.non_dominated(self.returns)

    @property
    def obeys(self) -> np.ndarray:
        """(K,) bool"""
        return pareto.obeys(self.returns, self.tradeoffs)

    def indicators(self, reference_front: ArrayLike | None = None) -> dict[str, float]:
        """Hypervolume, sparsity, expected utility, cardinality and obedience by name.

        `fall_rate` is there where falls are known, `igd_plus` where there is a reference front
        (n, m). A hypervolume that is not exact is called `hypervolume_approximate`.
        """
        returns = self.returns
        exact = pareto.is_exact(*returns.shape)
        found = {
            EXACT if exact else APPROXIMATE: self.hypervolume,
            "sparsity": pareto.sparsity(returns),
            "expected_utility": pareto.expected_utility(returns, self.tradeoffs),
            "cardinality": pareto.cardinality(returns),
            "obedience": pareto.obedience(returns, self.tradeoffs),
        }
        if self.falls is not None:
            found["fall_rate"] = float(self.falls.mean())
        if reference_front is not None:
            found["igd_plus"] = pareto.igd_plus(returns, reference_front)
        return found

    @property
    def hypervolume(self) -> float:
        return pareto.hypervolume(self.returns, self.reference_point)

    def averaged(self, episodes: int) -> Self:
        """The means over several episodes, where the K trade-offs stand `episodes` times in a row.

        (episodes * K, m) becomes (K, m); what is averaged are returns, lengths and falls.
        """

        def mean(values: np.ndarray) -> np.ndarray:
            return values.reshape(episodes, -1, *values.shape[1:]).mean(0)

        return self._replace(
            tradeoffs=self.tradeoffs[: len(self.tradeoffs) // episodes],
            returns=mean(self.returns),
            lengths=mean(self.lengths),
            falls=None if self.falls is None else mean(self.falls),
        )

    def save(self, path: Path) -> None:
        """Write an .npz with one array for each field, and `non_dominated`."""
        known = {name: value for name, value in self._asdict().items() if value is not None}
        with replacing(path) as file:
            np.savez_compressed(file, non_dominated=self.non_dominated, **known)

    @classmethod
    def load(cls, path: Path) -> Self:
        """What `save` wrote."""
        try:
            with path.open("rb") as file, np.load(file) as arrays:
                needed = [f for f in cls._fields if f in arrays or f not in cls._field_defaults]
                fields = {name: arrays[name] for name in needed}
        except FileNotFoundError:
            raise MorlaxError(f"there is no front {path}.") from None
        except Exception as error:  # a damaged archive trips numpy, zip or zlib in many ways
            raise MorlaxError(f"{path} is damaged or holds no front: {error}.") from None
        return cls(**{**fields, "objectives": tuple(map(str, fields["objectives"]))})


def hypervolume_in(names: Iterable[str]) -> str:
    """Which of the names of indicators is the hypervolume's, exact or approximate.

    Raises:
        StopIteration: none.
    """
    return next(name for name in names if name in (EXACT, APPROXIMATE))


class Evaluator:
    """Runs the deterministic policies of K trade-offs, one world each, for one episode.

    `latched`, the default: a return is the sum of rewards up to and including the first step that
    ends the episode. `paper`, the protocol behind the paper's tables: nothing ends an episode
    early; steps on which the robot counts as failed earn nothing, later ones may, and the
    reward that its `reset` reports is added.

    The environment has K worlds and no automatic reset.
    """

    def __init__(
        self, agent: Agent, env: Worlds, tradeoffs: Tensor, protocol: Protocol = "latched"
    ):
        if env.auto_reset or env.num_worlds != len(tradeoffs):
            raise ValueError("an evaluator needs one world per trade-off and auto_reset=False")
        self.agent, self.env, self.protocol = agent, env, protocol
        self.tradeoffs = tradeoffs.to(env.device)
        self._observation = env.reset()
        self._returns = torch.zeros_like(self.tradeoffs)
        self._alive = torch.ones(len(tradeoffs), dtype=torch.bool, device=env.device)
        self._fallen = torch.zeros_like(self._alive)
        self._lengths = torch.zeros(len(tradeoffs), dtype=torch.int32, device=env.device)
        with torch.no_grad():
            self._policies = {k: v.clone() for k, v in agent.actor(self.tradeoffs).items()}
        self._step = Graph(self._one_step, env.device, [env.generator])

    def compile(self) -> None:
        """Compile kernels and record the step."""
        self._step.record()

    @torch.no_grad()
    def evaluate(self) -> Front:
        """The front of the agent as it is now.

        Raises:
            MorlaxError: contacts no longer fitted the simulator's buffers.
        """
        for name, values in self.agent.actor(self.tradeoffs).items():
            self._policies[name].copy_(values)
        self._observation.copy_(self.env.reset())
        self._alive.fill_(True)
        self._fallen.zero_()
        self._lengths.zero_()
        self._returns.zero_()
        if self.protocol == "paper":
            self._returns += self.env.paper_reset_reward()
        with one_thread(self.env.device):
            for _ in range(self.env.episode_length):
                self._step()
        overflow = int(self.env.overflow().max())
        if overflow:
            remedy = self.env.remedy(overflow)
            raise MorlaxError(f"contacts overflowed their buffers in an evaluation: {remedy}.")
        return Front(
            self.env.objectives,
            self.tradeoffs.cpu().numpy(),
            self._returns.cpu().numpy().astype(np.float64),
            self._lengths.cpu().numpy(),
            np.array(self.env.reference_point),
            self._fallen.cpu().numpy().astype(np.float64),
        )

    @torch.no_grad()
    def _one_step(self) -> None:
        seen = self.agent.observation_normalizer(self._observation)
        output = self.agent.actor.run(self._policies, seen[:, None])[:, 0]
        mean, _ = output.chunk(2, dim=-1)
        step = self.env.step(mean.tanh())
        self._fallen |= step.terminated
        if self.protocol == "paper":
            self._alive.copy_(~step.terminated)
        counted = torch.where(self._alive[:, None], step.reward, 0.0)
        self._returns += counted
        self._lengths += self._alive
        if self.protocol == "latched":
            self._alive &= ~step.terminated
        self._observation.copy_(step.observation)
