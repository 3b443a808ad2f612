"""What a user may change about BRUCE's task."""

from typing import Self

from pydantic import Field, NonNegativeFloat, PositiveInt, field_validator

from ...worlds.options import TaskOptions
from . import model as bruce
from .beginnings import FASTEST


class BruceOptions(TaskOptions):
    """By default nothing is drawn at random."""

    objectives: dict[str, dict[str, float]] = {
        "joints": {"gait": 1.0},
        "base": {"base_position": 1.0, "base_attitude": 1.0},
        "swing": {"arm_swing": 1.0},
        "rigid": {"arm_hold": 1.0},
        "smooth": {"action_smoothness": 0.75, "joint_smoothness": 4.0},
        "energy": {"energy": 0.02},
    }
    shared: dict[str, float] = {"shift_size": 0.85, "shift_rate": 0.2}
    nconmax: int = 24
    njmax: int = 96
    chains: bruce.Chains = "closed"
    """closed: the robot as it is; tree: motors on tendons instead, faster and nearly alike."""
    feet: bruce.Feet = "equal"
    """equal, or published: there the left foot is 20 mm shorter, and it drifts sideways."""
    command: tuple[float, float] = (0.12, 0.0)
    """The velocity to walk at, m/s: forward (at most 0.2) and to the left (at most 0.1)."""
    draw_commands: bool = False
    """Tell each episode another velocity, and either foot to begin with."""
    standing: float = Field(default=0.4, ge=0, le=1)
    """How many of the drawn velocities are zero."""
    fastest: tuple[float, float] = FASTEST
    """The limits of drawn velocities, m/s: forward or backward, and to either side."""
    redraw_every: PositiveInt | None = None
    """Control steps after which a drawn velocity is drawn anew within an episode."""
    noise: NonNegativeFloat = 0.0
    """Scale of the sensors' noise (1: as published; 0: they are exact)."""
    randomize: bool = False
    """Give each world a torso, centres of mass, a floor and motors of its own, as published."""

    def for_evaluation(self) -> Self:
        changes = {"draw_commands": False, "noise": 0.0, "randomize": False}
        return super().for_evaluation().model_copy(update=changes)

    @field_validator("command", "fastest")
    @classmethod
    def _within_reach(cls, velocity: tuple[float, float]) -> tuple[float, float]:
        if any(abs(v) > most for v, most in zip(velocity, FASTEST, strict=True)):
            raise ValueError("the gaits go at most 0.2 m/s forward and 0.1 m/s sideways")
        return velocity
