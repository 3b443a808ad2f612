"""What a user may change about a task without touching Python."""

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
        raise ValueError(f"a range goes from the smaller to the larger: {limits[::-1]}")
    return limits


Range = Annotated[tuple[PositiveFloat, PositiveFloat], AfterValidator(_ordered)]
Steps = Annotated[tuple[NonNegativeInt, NonNegativeInt], AfterValidator(_ordered)]


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

    @property
    def varies(self) -> bool:
        """Whether chance has a part in what an episode brings."""
        return True


class Randomization(BaseModel):
    """What differs between worlds, or happens to them, at random; by default nothing does.

    Ranges are of factors, drawn uniformly once for each world, which keeps them in every episode.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)

    friction: Range | None = None
    """Range of a factor of all friction of a world."""
    mass: Range | None = None
    """Range of a factor of mass and inertia, for each body."""
    strength: Range | None = None
    """Range of a factor of force (gain and bias), for each actuator."""
    fields: dict[str, Range] = {}
    """Ranges of factors for each number of any other field of MjModel, such as dof_damping."""
    observation_noise: dict[str, NonNegativeFloat] = {}
    """Standard deviation of noise, in units of the observation, by the name of one of its parts
    (position.knee) or of the beginning of several (position)."""
    action_delay: Steps = (0, 0)
    """The fewest and the most control steps by which actions come late, drawn for each episode."""
    push: NonNegativeFloat = 0.0
    """By how much a push changes the robot's velocity, in m/s, in any horizontal direction."""
    push_every: PositiveInt = 200
    """Control steps from one push to the next, on average."""


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
    randomization: Randomization = Randomization()
    """What differs between worlds, or happens to them, at random."""

    def judged(self) -> Self:
        return self.model_copy(update={"stagger": False})

    @property
    def varies(self) -> bool:
        return self.reset_noise > 0 or self.randomization != Randomization()
