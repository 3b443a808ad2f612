"""The last transitions of all worlds, to learn from again."""

from typing import NamedTuple

import torch
from torch import Tensor

from ...envs import MorlaxError, Worlds
from ...host.resources import memory_of
from ..rollout import Rollout

MOST = 0.5  # share of the memory that a replay may take


class Transitions(NamedTuple):
    """S steps, or stretches of a few, in any worlds."""

    observation: Tensor  # (S, O + P) raw, as critics see it
    action: Tensor  # (S, A) in (-1, 1)
    reward: Tensor  # (S, m) discounted sum over the stretch
    following: Tensor  # (S, O + P) raw, after the stretch and before any reset
    discount: Tensor  # (S, 1) of the value of `following`: 0 if the episode terminated there
    tradeoff: Tensor  # (S, m) that acted


class Replay:
    """A ring of the last steps of N worlds, on their device.

    Nothing waits for the GPU, so storing and sampling can be recorded.

    Args:
        capacity: R, the number of steps of all worlds that it holds.
        clusters: K, of which each has a trade-off.
        env: the worlds.

    Raises:
        MorlaxError: it would take more than MOST of the device's memory.
    """

    def __init__(self, capacity: int, clusters: int, env: Worlds):
        features, number = env.observation_size + env.privileged_size, capacity * env.num_worlds
        size = 4 * (2 * features + env.action_size + len(env.objectives)) + 2  # bytes of each
        most = MOST * memory_of(env.device)
        if number * size > most:
            raise MorlaxError(
                f"a replay of {number:,} transitions takes {number * size / 2**30:.1f} GiB, more "
                f"than {MOST:.0%} of the memory of {env.device}: "
                f"try --method.replay {int(most / size)}."
            )

        def zeros(*shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
            return torch.zeros(capacity, env.num_worlds, *shape, dtype=dtype, device=env.device)

        self.capacity, self.num_worlds = capacity, env.num_worlds
        self._observation, self._following = zeros(features), zeros(features)
        self._action, self._reward = zeros(env.action_size), zeros(len(env.objectives))
        self._terminated, self._over = zeros(dtype=torch.bool), zeros(dtype=torch.bool)
        self._tradeoff = self._reward.new_zeros(capacity, clusters, self._reward.shape[-1])
        self._stored = torch.zeros((), dtype=torch.int64, device=env.device)  # steps so far

    def state(self) -> list[Tensor]:
        """Return all tensors, in a fixed order; all are updated in place."""
        episodes = self._terminated, self._over, self._stored, self._tradeoff
        return [self._observation, self._following, self._action, self._reward, *episodes]

    def clear(self) -> None:
        self._stored.zero_()

    def add(self, rollout: Rollout, tradeoffs: Tensor) -> None:
        """Store the T steps of a rollout with trade-offs (K, m) in place of the oldest ones."""
        steps = len(rollout.reward)
        rows = (self._stored + torch.arange(steps, device=self._stored.device)) % self.capacity
        pairs = (
            (self._observation, rollout.observation),
            (self._following, rollout.final_observation),
            (self._action, rollout.action.tanh()),
            (self._reward, rollout.reward),
            (self._terminated, rollout.terminated),
            (self._over, rollout.terminated | rollout.truncated),
        )
        for column, values in pairs:
            column.index_copy_(0, rows, values.flatten(1, 2))
        self._tradeoff.index_copy_(0, rows, tradeoffs.expand(steps, -1, -1))
        self._stored += steps

    def sample(
        self, number: int, steps: int, discount: float, generator: torch.Generator
    ) -> Transitions:
        """Draw stretches of up to `steps` steps, each from any step of any world.

        A stretch ends where its episode does, also at a time limit, where the value of the last
        state still counts, or at the newest step.

        Args:
            number: S.
            steps: n of n-step returns (Sutton, 1988).
            discount: gamma, per control step.
            generator: draws them.
        """
        held = self._stored.clamp(max=self.capacity)
        draws = self._reward.new_empty(2, number).uniform_(generator=generator)
        age = (draws[0] * held).long().clamp(max=held - 1)  # 0 is the oldest
        world = (draws[1] * self.num_worlds).long().clamp(max=self.num_worlds - 1)
        oldest = self._stored - held

        def row(later: int) -> Tensor:
            return (oldest + age + later) % self.capacity

        first = last = row(0)
        reward, factor = self._reward[first, world], torch.full_like(draws[0], discount)
        goes_on = ~self._over[first, world]
        for later in range(1, steps):
            here = row(later)
            goes_on = goes_on & (age + later < held)
            gain = factor[:, None] * self._reward[here, world]
            reward = reward + torch.where(goes_on[:, None], gain, 0.0)
            factor = torch.where(goes_on, factor * discount, factor)
            last = torch.where(goes_on, here, last)
            goes_on = goes_on & ~self._over[here, world]
        ended = self._terminated[last, world]
        return Transitions(
            self._observation[first, world],
            self._action[first, world],
            reward,
            self._following[last, world],
            torch.where(ended, 0.0, factor)[:, None],
            self._tradeoff[first, world // (self.num_worlds // self._tradeoff.shape[1])],
        )
