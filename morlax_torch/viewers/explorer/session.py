"""One robot in real time, with the actions that the page offers. It needs no browser."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from ...envs import MorlaxError
from ...envs.worlds.design_space import DesignSpace
from ...envs.worlds.trees import horizontal
from ...evaluation.front import Front
from ...networks.policy import Policy
from ...runs.loading import load, load_front
from ..player import Player
from .behavior import Behavior
from .library import Choice

Weights = tuple[float, ...]  # a trade-off: not negative, and sums to one
PUSH = 1.5  # m/s added to the robot's velocity by a push


@dataclass
class Episode:
    """How an episode ended."""

    returns: list[float]  # (m,)
    seconds: float
    fell: bool


class Session(Behavior):
    """A robot and its trade-off.

    Callers may set `tradeoff` at any time; a new one acts from the next control step.

    Args:
        policy: as `morlax_torch.load` returns it.
        front: of these policies, if it was evaluated.
        seed: random seed of the world and of the pushes.

    Raises:
        MorlaxError: the task has no MuJoCo robot.
    """

    def __init__(self, policy: Policy, front: Front | None, seed: int = 0):
        self.objectives, self.front, self._seed = policy.objectives, front, seed
        self.tradeoff: Weights = (1 / len(self.objectives),) * len(self.objectives)
        self.player = player = Player(policy, self.tradeoff, seed)
        super().__init__(player.model, player.data, player.env.dt)
        self.last_episode: Episode | None = None
        self.axes = horizontal(self.model, player.env.base)
        self._acting_on = self.tradeoff
        self._opened = self._looks = policy
        self._directions = np.random.default_rng(seed)

    @classmethod
    def open(cls, choice: Choice) -> Self:
        """Show a checkpoint.

        Raises:
            MorlaxError: the checkpoint is missing or damaged, or the task has no MuJoCo robot.
        """
        policy = load(choice.file)
        return cls(policy, _front(choice))

    def twin(self) -> Self:
        """Return another robot with the same policy, trade-off, command and pace."""
        other = type(self)(self.player.policy, self.front)
        other._opened, other._looks = self._opened, self._looks
        other.tradeoff, other.paused, other.pace = self.tradeoff, self.paused, self.pace
        other.player.command = list(self.player.command)
        return other

    @property
    def robot(self) -> object:
        return self._looks

    @property
    def design(self) -> list[float]:
        """The body's design parameters (d,)."""
        policy = self.player.policy
        if not len(policy.agent.context):
            return []
        return DesignSpace(policy.agent.designs).vector(policy.config.task.design).tolist()

    @property
    def reshaped(self) -> Policy | None:
        """The policy, if its body is not that of the checkpoint."""
        policy = self.player.policy
        return None if policy.config.task == self._opened.config.task else policy

    def reshape(self, policy: Policy) -> None:
        """Go on with the body of another policy of this family, in a new episode.

        Its front is unknown until `measured`.
        """
        player = Player(policy, self.tradeoff, self._seed)
        player.command = self.player.command
        self.player, self.model, self.data, self.front = player, player.model, player.data, None
        self._acting_on, self.steps = self.tradeoff, 0

    def measured(self, front: Front | None) -> None:
        """Show the front of the body from now on."""
        self.front, self._looks = front, self.player.policy

    @property
    def seconds(self) -> float:
        """Simulated seconds since the episode began."""
        return self.player.steps * self.dt

    def step(self) -> None:
        """Take one control step; if the episode is over, start a new one first."""
        player = self.player
        if self.tradeoff != self._acting_on:
            player.tradeoff = self.tradeoff
            self._acting_on = self.tradeoff
        if player.over:
            fell = player.steps < player.env.episode_length
            self.last_episode = Episode(player.returns.tolist(), self.seconds, fell)
            self.reset()
        player.step()
        self.steps = player.steps

    def reset(self) -> None:
        """Start a new episode."""
        self.player.reset()
        self.steps = 0

    def push(self) -> None:
        """Add `PUSH` m/s to the robot's velocity, in a random direction of its horizontal axes."""
        if not self.axes:
            return
        kick = self._directions.normal(size=len(self.axes))
        velocity = self.player.env.physics.qvel[0]
        for dof, part in zip(self.axes, PUSH * kick / np.linalg.norm(kick), strict=True):
            velocity[dof] += part

    def tell(self, index: int, value: float) -> None:
        """Set one number of the command, by its index; it is clamped to the task's limits."""
        low, high = list(self.player.env.command_limits.values())[index]
        self.player.command[index] = min(max(value, low), high)

    def velocity(self) -> list[float]:
        """Return the velocity in m/s along x and, if the robot can move there, y."""
        return [float(self.data.qvel[dof]) for dof in self.axes]

    def power(self) -> float:
        """Return the motors' mechanical power in watts; absorbed power counts as positive too."""
        return float(np.abs(self.data.actuator_force * self.data.actuator_velocity).sum())


def _front(choice: Choice) -> Front | None:
    """Load the front of a checkpoint, if it has one with finite returns."""
    try:
        front = load_front(choice.file)
    except MorlaxError:
        return None
    return front if np.isfinite(front.returns).all() else None
