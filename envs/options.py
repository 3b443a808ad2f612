"""What a user may change about a task without touching Python."""

from typing import Self

from pydantic import BaseModel, ConfigDict, NonNegativeFloat, PositiveInt, field_validator


class ObjectiveOptions(BaseModel):
    """The options of whatever has several objectives."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)

    objectives: dict[str, dict[str, float]]
    """What is traded off: each objective is a weighted sum of reward terms."""
    shared: dict[str, float] = {}
    """Weighted reward terms that every objective counts."""
    reference_point: tuple[float, ...] | None = None
    """Where hypervolume is measured from, a number for each objective (None: the origin)."""
    episode_length: PositiveInt = 500
    """Control steps after which an episode is truncated."""

    def judged(self) -> Self:
        """Those under which policies are judged and shown: without what only training draws."""
        return self

    @field_validator("objectives")
    @classmethod
    def _at_least_two(cls, objectives: dict[str, dict[str, float]]) -> dict[str, dict[str, float]]:
        if len(objectives) < 2:
            raise ValueError("a trade-off needs at least two objectives")
        return objectives


class TaskOptions(ObjectiveOptions):
    """The options of every robot; a task states its own defaults, and may add to them."""

    reset_noise: NonNegativeFloat = 0.0
    """Spread of the initial state: uniform for positions (m, rad), normal for velocities."""
    stagger: bool = False
    """Start first episodes at random ages, so that worlds are not truncated all at once."""
    solver_iterations: PositiveInt | None = None
    """Iteration limit of the constraint solver (None: the model's own)."""
    nconmax: PositiveInt = 48
    """Contacts that MuJoCo Warp makes room for, for each world."""
    njmax: PositiveInt = 64
    """Constraint rows that MuJoCo Warp makes room for, for each world."""
