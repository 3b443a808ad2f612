"""One robot in real time, with the actions that the page offers. It needs no browser."""

import math
from dataclasses import dataclass

import numpy as np

from ...envs import MorlaxError
from ...envs.worlds.disturbances import horizontal
from ...evaluation.front import Front
from ...runs.loading import find_run, load
from ..player import Player
from .history import History
from .library import Choice
from .weights import Weights, even

PUSH = 1.5  # m/s added to the robot's velocity by a push
MAX_LAG = 0.1  # s of delay to catch up with; the rest of a longer delay is dropped


@dataclass
class Episode:
    """How an episode ended."""

    returns: list[float]  # (m,)
    seconds: float
    fell: bool


class Session:
    """A robot, its trade-off, its playback speed and its recent history.

    Callers may set `tradeoff`, `paused` and `pace` (1 is real time) at any time; a new trade-off
    acts from the next control step. Use a session from one thread only.

    Args:
        choice: the checkpoint.
        seed: random seed of the world and of the pushes.

    Raises:
        MorlaxError: the checkpoint is missing or damaged, or the task has no MuJoCo robot.
    """

    def __init__(self, choice: Choice, seed: int = 0):
        policy = load(choice.file)
        self.objectives = policy.objectives
        self.tradeoff: Weights = even(len(self.objectives))
        self.player = Player(policy, self.tradeoff, seed)
        self.front = _front(choice.run, self.objectives)
        self.paused, self.pace = False, 1.0
        self.time = 0.0  # simulated seconds
        self.last_episode: Episode | None = None
        self.axes = horizontal(self.player.model)
        # signals: running returns, velocity along each axis, mechanical power
        self.history = History(len(self.objectives) + len(self.axes) + 1)
        self._acting_on = self.tradeoff
        self._clock: float | None = None
        self._due = 0.0
        self._directions = np.random.default_rng(seed)

    @property
    def dt(self) -> float:
        """Duration of a control step in seconds."""
        return self.player.env.dt

    @property
    def seconds(self) -> float:
        """Simulated seconds since the episode began."""
        return self.player.steps * self.dt

    def advance(self, now: float) -> int:
        """Take the control steps that are due at clock time `now` in seconds; returns how many."""
        elapsed = 0.0 if self._clock is None else now - self._clock
        self._clock = now
        if self.paused:
            return 0
        self._due += min(elapsed, MAX_LAG) * self.pace
        steps = int(self._due / self.dt + 1e-9)
        self._due -= steps * self.dt
        for _ in range(steps):
            self.step()
        return steps

    def until_next(self) -> float:
        """Return the clock seconds until the next step is due, at most `MAX_LAG`."""
        wait = MAX_LAG if self.paused else (self.dt - self._due) / self.pace
        return min(max(wait, 0.0), MAX_LAG)

    def step(self) -> None:
        """Take one control step; if the episode is over, start a new one first."""
        player = self.player
        if self.tradeoff != self._acting_on:
            player.tradeoff = self.tradeoff
            self._acting_on = self.tradeoff
        if player.over:
            fell = player.steps < player.env.episode_length
            self.last_episode = Episode(player.returns.tolist(), self.seconds, fell)
            player.reset()
        player.step()
        self.time += self.dt
        signals = [*player.returns.tolist(), *self.velocity(), self.power()]
        self.history.add(self.time, [x if math.isfinite(x) else 0.0 for x in signals])

    def reset(self) -> None:
        """Start a new episode."""
        self.player.reset()

    def push(self) -> None:
        """Add `PUSH` m/s to the robot's velocity, in a random direction of its horizontal axes."""
        if not self.axes:
            return
        kick = self._directions.normal(size=len(self.axes))
        velocity = self.player.env.physics.qvel[0]
        for dof, part in zip(self.axes, PUSH * kick / np.linalg.norm(kick), strict=True):
            velocity[dof] += part

    def tell(self, index: int, value: float) -> None:
        """Set one number of the command, by its index in the task's `command_limits`."""
        self.player.command[index] = value

    def velocity(self) -> list[float]:
        """Return the velocity in m/s along x and, if the robot can move there, y."""
        return [float(self.player.data.qvel[dof]) for dof in self.axes]

    def power(self) -> float:
        """Return the motors' mechanical power in watts; absorbed power counts as positive too."""
        data = self.player.data
        return float(np.abs(data.actuator_force * data.actuator_velocity).sum())

    def nearest(self) -> int | None:
        """Return the index of the nearest evaluated trade-off; None without a front."""
        if self.front is None:
            return None
        return int(np.square(self.front.tradeoffs - np.array(self.tradeoff)).sum(1).argmin())


def _front(run: str, objectives: tuple[str, ...]) -> Front | None:
    """Load a run's last evaluation, if it has one with these objectives and finite returns."""
    try:
        front = Front.load(find_run(run) / "front.npz")
    except MorlaxError:
        return None
    fits = front.objectives == objectives and np.isfinite(front.returns).all()
    return front if fits else None
