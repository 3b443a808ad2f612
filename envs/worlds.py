"""What a learner asks of many copies of a task, whatever moves them."""

from abc import ABC, abstractmethod
from typing import Any, ClassVar, NamedTuple

import gymnasium
import numpy as np
import torch
from torch import Tensor

from .errors import MorlaxError, unknown
from .options import ObjectiveOptions


class TimeStep(NamedTuple):
    """What one control step of N worlds gave."""

    observation: Tensor  # (N, O) what the policy acts on next, after any reset
    reward: Tensor  # (N, m) a column for each objective
    terminated: Tensor  # (N,) bool: the episode failed, its future is worth nothing
    truncated: Tensor  # (N,) bool: time ran out, its future still has value
    final_observation: Tensor  # (N, O) what was seen before any reset
    terms: dict[str, Tensor]  # (N,) each: the reward terms, unweighted
    critic_observation: Tensor  # (N, O + P) the observation, and behind it what is privileged
    final_critic_observation: Tensor  # (N, O + P) likewise, before any reset


class Worlds(ABC):
    """N worlds of one task with several objectives, stepped together.

    Reward terms are combined into objectives by `options`. A world whose episode ends is reset
    within the same step (`auto_reset`).
    """

    Options: ClassVar[type[ObjectiveOptions]]
    simulator: str  # the name of what moves them
    options: ObjectiveOptions
    num_worlds: int
    device: torch.device
    auto_reset: bool
    episode_length: int
    observation_size: int
    privileged_size: int = 0  # P, how much more critics see
    action_size: int
    reward_terms: tuple[str, ...]
    objectives: tuple[str, ...]
    reference_point: tuple[float, ...]
    generator: torch.Generator  # of what is drawn at random while stepping
    blowups: Tensor  # () int64: how often a world was no longer finite
    _weights: Tensor  # (terms, m)

    @abstractmethod
    def reset(self) -> Tensor:
        """Start every world anew; returns the observation (N, O)."""

    @abstractmethod
    def restart(self, which: Tensor) -> Tensor:
        """Start the worlds of a mask (N,) anew, and no other; returns the observation (N, O)."""

    @abstractmethod
    def step(self, action: Tensor) -> TimeStep:
        """Advance every world by one control step under `action` (N, A) in [-1, 1]."""

    @abstractmethod
    def critic_observation(self) -> Tensor:
        """(N, O + P) what critics see now: the observation, and behind it what is privileged."""

    @abstractmethod
    def overflow(self) -> Tensor:
        """(N,) int32, non-zero where the simulator ran out of room."""

    @abstractmethod
    def remedy(self, bits: int) -> str:
        """What to do about the union `bits` of what `overflow` returned, in words."""

    @abstractmethod
    def state_dict(self) -> dict[str, Any]:
        """A copy of all that the worlds' future depends on."""

    @abstractmethod
    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go back to a state of the same number of worlds, in place."""

    def combine(self, terms: dict[str, Tensor]) -> Tensor:
        """Reward terms (N,) each, to the reward of every objective (N, m)."""
        return (torch.stack(list(terms.values()), -1).unsqueeze(-1) * self._weights).sum(1)

    def _weighting(self) -> list[list[float]]:
        objectives, shared = self.options.objectives, self.options.shared
        for name in [*shared, *(name for group in objectives.values() for name in group)]:
            if name not in self.reward_terms:
                raise unknown("reward term", name, self.reward_terms)
        return [
            [shared.get(name, 0.0) + group.get(name, 0.0) for group in objectives.values()]
            for name in self.reward_terms
        ]

    def _reference_point(self) -> tuple[float, ...]:
        point = self.options.reference_point
        if point is None:
            return (0.0,) * len(self.objectives)
        if len(point) != len(self.objectives):
            raise MorlaxError(
                f"reference_point has {len(point)} numbers, but there are "
                f"{len(self.objectives)} objectives: {', '.join(self.objectives)}."
            )
        return point

    def paper_reset_reward(self) -> Tensor:
        """(m,) what the paper's evaluation protocol adds to every return."""
        return torch.zeros(len(self.objectives), device=self.device)

    @property
    def observation_space(self) -> gymnasium.spaces.Box:
        """What one world shows."""
        return gymnasium.spaces.Box(-np.inf, np.inf, (self.observation_size,), np.float32)

    @property
    def action_space(self) -> gymnasium.spaces.Box:
        """What one world takes."""
        return gymnasium.spaces.Box(-1.0, 1.0, (self.action_size,), np.float32)

    @property
    def reward_space(self) -> gymnasium.spaces.Box:
        """What one world pays, a number for each objective, in `objectives`' order."""
        return gymnasium.spaces.Box(-np.inf, np.inf, (len(self.objectives),), np.float32)
