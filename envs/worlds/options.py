"""Task options: what users may change without touching Python."""

from typing import Annotated, Self, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
    field_validator,
)

T = TypeVar("T", int, float)


def _ordered(limits: tuple[T, T]) -> tuple[T, T]:
    if limits[0] > limits[1]:
        raise ValueError(f"a range goes from the smaller to the larger number: {limits[::-1]}")
    return limits


Range = Annotated[tuple[PositiveFloat, PositiveFloat], AfterValidator(_ordered)]
Steps = Annotated[tuple[NonNegativeInt, NonNegativeInt], AfterValidator(_ordered)]


class ObjectiveOptions(BaseModel):
    """The options of every task."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)

    objectives: dict[str, dict[str, float]]
    """The objectives to trade off; each is a weighted sum of reward terms."""
    shared: dict[str, float] = {}
    """Weighted reward terms that are added to every objective."""
    reference_point: tuple[float, ...] | None = None
    """Reference point of the hypervolume, one number per objective (None: the origin)."""
    episode_length: PositiveInt = 500
    """Control steps after which an episode is truncated."""

    def for_evaluation(self) -> Self:
        """Return the options to evaluate and show policies under, without training-only draws."""
        return self

    @field_validator("objectives")
    @classmethod
    def _at_least_two(cls, objectives: dict[str, dict[str, float]]) -> dict[str, dict[str, float]]:
        if len(objectives) < 2:
            raise ValueError("a trade-off needs at least two objectives")
        return objectives

    @property
    def varies(self) -> bool:
        """Whether episodes of one policy differ at random."""
        return True


class Randomization(BaseModel):
    """Domain randomization; by default there is none.

    Ranges are of factors, drawn uniformly once for each world and kept in every episode.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)

    friction: Range | None = None
    """Range of one factor per world on all friction."""
    mass: Range | None = None
    """Range of one factor per body on its mass and inertia."""
    strength: Range | None = None
    """Range of one factor per actuator on its force (gain and bias)."""
    fields: dict[str, Range] = {}
    """Ranges of factors on each number of other fields of MjModel, such as dof_damping."""
    observation_noise: dict[str, NonNegativeFloat] = {}
    """Standard deviation of observation noise, in units of the observation, by the name of a part
    (position.knee) or a prefix of several (position)."""
    action_delay: Steps = (0, 0)
    """Smallest and largest action delay in control steps, drawn for each episode."""
    push: NonNegativeFloat = 0.0
    """Change of the robot's velocity by a push, in m/s, in a random horizontal direction."""
    push_every: PositiveInt = 200
    """Mean number of control steps between pushes."""


class TaskOptions(ObjectiveOptions):
    """The options of every MuJoCo robot; a task sets its own defaults and may add options."""

    reset_noise: NonNegativeFloat = 0.0
    """Spread of the initial state: uniform on positions (m, rad), normal on velocities."""
    stagger: bool = False
    """Start first episodes at random ages, so that time limits do not coincide."""
    solver_iterations: PositiveInt | None = None
    """Iteration limit of the constraint solver (None: as in the MJCF)."""
    nconmax: PositiveInt = 48
    """Contact buffer of MuJoCo Warp, per world."""
    njmax: PositiveInt = 64
    """Constraint-row buffer of MuJoCo Warp, per world."""
    randomization: Randomization = Randomization()
    """Domain randomization."""

    def for_evaluation(self) -> Self:
        return self.model_copy(update={"stagger": False})

    @property
    def varies(self) -> bool:
        return self.reset_noise > 0 or self.randomization != Randomization()
