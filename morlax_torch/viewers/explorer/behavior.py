"""A robot that moves in real time, live or recorded."""

from abc import ABC, abstractmethod

import mujoco

MAX_LAG = 0.1  # s of delay to catch up with; the rest of a longer delay is dropped


class Behavior(ABC):
    """The states of one MuJoCo robot over time, as a page shows them.

    Callers may set `paused` and `pace` (1 is real time) at any time. `steps` are those since the
    beginning. Use a behavior from one thread only.

    Args:
        model: the robot.
        data: its current state; `step` updates positions of bodies in place.
        dt: seconds of a step.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, dt: float):
        self.model, self.data, self.dt = model, data, dt
        self.paused, self.pace = False, 1.0
        self.steps = 0  # since the beginning
        self._clock: float | None = None
        self._due = 0.0

    @property
    @abstractmethod
    def robot(self) -> object:
        """What is the same object for behaviors that look alike and can stand side by side."""

    @abstractmethod
    def step(self) -> None:
        """Move on by `dt` seconds, and count it in `steps`."""

    @abstractmethod
    def reset(self) -> None:
        """Go back to the beginning."""

    def advance(self, now: float) -> int:
        """Take the steps that are due at clock time `now` in seconds; returns how many."""
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
