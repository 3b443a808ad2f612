"""One robot at the pace of the clock, and what may be asked of it. It needs no browser."""

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

PUSH = 1.5  # m/s that a push adds to the robot's velocity
MAX_LAG = 0.1  # s that may be caught up with; a longer pause of the computer is forgotten


@dataclass
class Episode:
    """How an episode ended."""

    returns: list[float]  # (m,)
    seconds: float
    fell: bool


class Session:
    """A robot, the trade-off it acts on, its pace and its recent past.

    `tradeoff`, `paused` and `pace` (1 is real time) are for anyone to set; a new trade-off counts
    from the next control step on. All calls come from one thread.

    Raises:
        MorlaxError: the checkpoint is none, or damaged.
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
        # running returns, velocity along each axis, mechanical power
        self.history = History(len(self.objectives) + len(self.axes) + 1)
        self._acting_on = self.tradeoff
        self._clock: float | None = None
        self._due = 0.0
        self._directions = np.random.default_rng(seed)

    @property
    def dt(self) -> float:
        """Seconds per control step."""
        return self.player.env.dt

    @property
    def seconds(self) -> float:
        """Of this episode."""
        return self.player.steps * self.dt

    def advance(self, now: float) -> int:
        """Make the control steps due at the time `now` in seconds; returns how many."""
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
        """Seconds of the clock until a step is due, at most `MAX_LAG`."""
        wait = MAX_LAG if self.paused else (self.dt - self._due) / self.pace
        return min(max(wait, 0.0), MAX_LAG)

    def step(self) -> None:
        """One control step; an episode that is over begins anew first."""
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
        """Begin a new episode."""
        self.player.reset()

    def push(self) -> None:
        """Knock the whole robot by `PUSH` m/s in some horizontal direction, if it can go there."""
        if not self.axes:
            return
        kick = self._directions.normal(size=len(self.axes))
        velocity = self.player.env.physics.qvel[0]
        for dof, part in zip(self.axes, PUSH * kick / np.linalg.norm(kick), strict=True):
            velocity[dof] += part

    def tell(self, index: int, value: float) -> None:
        """Change a number of the robot's command."""
        self.player.command[index] = value

    def velocity(self) -> list[float]:
        """m/s along x and, where the robot is free to go there, y."""
        return [float(self.player.data.qvel[dof]) for dof in self.axes]

    def power(self) -> float:
        """Watts: what the motors give and take, both counted as positive."""
        data = self.player.data
        return float(np.abs(data.actuator_force * data.actuator_velocity).sum())

    def nearest(self) -> int | None:
        """The index of the front's evaluated trade-off that is nearest to the current one."""
        if self.front is None:
            return None
        return int(np.square(self.front.tradeoffs - np.array(self.tradeoff)).sum(1).argmin())


def _front(run: str, objectives: tuple[str, ...]) -> Front | None:
    """The last evaluation of a run, if it has one that fits."""
    try:
        front = Front.load(find_run(run) / "front.npz")
    except MorlaxError:
        return None
    fits = front.objectives == objectives and np.isfinite(front.returns).all()
    return front if fits else None
