"""Disturbances of a played robot: delay, noise, pushes and friction."""

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from ...envs import MorlaxError

PAUSES = 1.0, 3.0  # s between two pushes, as in mjlab's training


@dataclass
class Disturbances:
    """Strengths of disturbances; delay and friction are drawn anew for each episode.

    Raises:
        MorlaxError: a strength is not usable.
    """

    delay: tuple[float, float] = (0.0, 20.0)
    """Milliseconds from an observation to the action that it causes."""
    noise: float = 1.0
    """Factor on the observation noise of the training."""
    push: float = 0.5
    """Largest change of the base's horizontal velocity, in m/s along each axis."""
    friction: tuple[float, float] = (0.3, 1.2)
    """Sliding friction of all contacts that have friction."""

    def __post_init__(self) -> None:
        for name, (low, high) in (("delay", self.delay), ("friction", self.friction)):
            if not 0 <= low <= high < math.inf:
                raise MorlaxError(
                    f"--{name} needs two numbers, the lower one first and not negative, not "
                    f"{low:g} {high:g}."
                )
        for name in ("noise", "push"):
            if not 0 <= getattr(self, name) < math.inf:
                raise MorlaxError(f"--{name} must not be negative, nor {getattr(self, name):g}.")


NONE = Disturbances((0.0, 0.0), 0.0, 0.0, (1.0, 1.0))


class Disturber:
    """Applies disturbances to one model, with draws from `rng`."""

    def __init__(
        self, strengths: Disturbances | None, model: mujoco.MjModel, rng: np.random.Generator
    ):
        self._strengths, self._model, self._rng = strengths or NONE, model, rng
        self._changes_friction = strengths is not None
        collides = (model.geom_contype | model.geom_conaffinity) > 0
        self._sliding = collides & (model.geom_condim > 1)
        self.delay = 0  # in physics steps

    def restart(self) -> None:
        """Draw delay, friction and the time of the first push of an episode."""
        delay = self._rng.uniform(*self._strengths.delay)
        self.delay = round(delay / 1000 / self._model.opt.timestep)
        if self._changes_friction:
            self._model.geom_friction[self._sliding, 0] = self._rng.uniform(
                *self._strengths.friction
            )
        self._next_push = self._rng.uniform(*PAUSES)

    def push(self, data: mujoco.MjData, speed: int) -> None:
        """Change the velocity of the base, which starts at `speed` in qvel, if it is time."""
        if data.time >= self._next_push:
            self._next_push = data.time + self._rng.uniform(*PAUSES)
            most = self._strengths.push
            data.qvel[speed : speed + 2] += self._rng.uniform(-most, most, 2)

    def noisy(self, values: np.ndarray, amplitude: float) -> np.ndarray:
        """Return one term of an observation with uniform noise."""
        most = amplitude * self._strengths.noise
        return values + self._rng.uniform(-most, most, values.shape) if most else values
