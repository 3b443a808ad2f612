"""Options of BRUCE's task."""

from typing import Self

from pydantic import Field, NonNegativeFloat, field_validator

from ...worlds.options import Count, Objectives, TaskOptions
from . import model as bruce
from .beginnings import FASTEST


class BruceOptions(TaskOptions):
    """The options of BRUCE; by default nothing is random."""

    objectives: Objectives = {
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
    """closed: as on the robot; tree: motors on tendons instead, faster and nearly the same."""
    feet: bruce.Feet = "equal"
    """equal, or published: the left foot is 20 mm shorter, and the robot drifts sideways."""
    command: tuple[float, float] = (0.12, 0.0)
    """Commanded velocity in m/s, forward (at most 0.2) and to the left (at most 0.1)."""
    draw_commands: bool = False
    """Draw a velocity for each episode, starting with either foot."""
    standing: float = Field(default=0.4, ge=0, le=1)
    """Share of drawn velocities that are zero."""
    fastest: tuple[float, float] = FASTEST
    """Limits of drawn velocities in m/s, forward or backward, and to either side."""
    redraw_every: Count | None = None
    """Control steps after which a new velocity is drawn within an episode (None: never)."""
    noise: NonNegativeFloat = 0.0
    """Scale of the uniform sensor noise (1: as published; 0: exact sensors)."""
    randomize: bool = False
    """Randomize torso mass, centers of mass, friction and motor gains per world, as published."""

    @field_validator("reset_noise")
    @classmethod
    def _starts_from_gaits(cls, noise: float) -> float:
        if noise:
            raise ValueError("BRUCE starts from states of its gaits: leave reset_noise at 0")
        return noise

    def for_evaluation(self) -> Self:
        fields = type(self).model_fields
        training_only = (
            "draw_commands",
            "standing",
            "fastest",
            "redraw_every",
            "noise",
            "randomize",
        )
        changes = {name: fields[name].default for name in training_only}
        return super().for_evaluation().model_copy(update=changes)

    @field_validator("command", "fastest")
    @classmethod
    def _within_reach(cls, velocity: tuple[float, float]) -> tuple[float, float]:
        if any(abs(v) > most for v, most in zip(velocity, FASTEST, strict=True)):
            raise ValueError("use at most 0.2 m/s forward and 0.1 m/s sideways: no gait is faster")
        return velocity
