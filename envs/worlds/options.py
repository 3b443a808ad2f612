"""The options of tasks: objectives, episodes, simulation and domain randomization."""

import re
from collections.abc import Collection, Mapping
from typing import Annotated, Any, ClassVar, Self, TypeVar, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    NonNegativeFloat,
    ValidationInfo,
    field_validator,
    model_validator,
)

from ..errors import shortened, unknown

STORED = "stored"  # context of the values of a run, which an earlier version may have written
MOST = 31  # objectives, of which moocore computes a hypervolume
LARGEST = 1e9  # of any number, in size: squares of it are still finite in float32

Objectives = dict[str, dict[str, float]]  # weights of reward terms, by objective
Point = tuple[float, ...] | None  # of reference, one number per objective
Names = TypeVar("Names", bound=Collection[str])
Count = Annotated[int, Field(gt=0, le=1_000_000)]
PLAIN_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_ -]{0,39}")
Factor = Annotated[float, Field(gt=0, le=1e6)]
Delay = Annotated[int, Field(ge=0, le=1000)]


class Section(BaseModel):
    """A group of options; unknown keys, infinite numbers and those above LARGEST are refused."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        use_attribute_docstrings=True,
        allow_inf_nan=False,
        validate_default=True,
    )

    vast: ClassVar[tuple[str, ...]] = ()  # options that may be larger than LARGEST

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a copy with other values, which are not checked; their names are."""
        for name in update or {}:
            if name not in type(self).model_fields:
                raise unknown("key", name, type(self).model_fields)
        return super().model_copy(update=update, deep=deep)

    @model_validator(mode="before")
    @classmethod
    def _without_former(cls, values: Any, info: ValidationInfo) -> Any:
        """Leave out options that this version lacks, if a stored run does not use them."""
        if info.context != STORED or not isinstance(values, dict):
            return values
        return {k: v for k, v in values.items() if k in cls.model_fields or v is not None}

    @field_validator("*", mode="before")
    @classmethod
    def _no_truth_for_numbers(cls, value: object, info: ValidationInfo) -> object:
        kind = cls.model_fields[str(info.field_name)].annotation
        if isinstance(value, bool) and bool not in (kind, *get_args(kind)):
            raise ValueError("true and false are neither numbers nor names")
        return value

    @field_validator("*")
    @classmethod
    def _moderate(cls, value: object, info: ValidationInfo) -> object:
        if isinstance(value, dict | tuple | list):
            for part in value.values() if isinstance(value, dict) else value:
                cls._moderate(part, info)
        elif isinstance(value, float) and abs(value) > LARGEST and info.field_name not in cls.vast:
            raise ValueError(f"{value:g} is too large: use at most {LARGEST:g} in size")
        return value


def _ordered(limits: tuple[float, float]) -> tuple[float, float]:
    if limits[0] > limits[1]:
        raise ValueError(f"a range goes from the smaller to the larger number: {limits[::-1]}")
    return limits


def check_objectives(names: Names) -> Names:
    """Raise ValueError unless these are plain names of 2 to 31 objectives; return them."""
    if len(names) < 2:
        raise ValueError("a trade-off needs at least two objectives")
    if len(names) > MOST:
        raise ValueError(f"{len(names)} objectives are too many: use at most {MOST}")
    for name in names:
        if not PLAIN_NAME.fullmatch(name):
            raise ValueError(
                f"the name of an objective cannot be {shortened(name)}: use at most 40 letters "
                "(A-Z, a-z), digits, spaces, _ and -, and start with a letter or digit"
            )
    return names


Range = Annotated[tuple[Factor, Factor], AfterValidator(_ordered)]
Limits = Annotated[tuple[float, float], AfterValidator(_ordered)]
Steps = Annotated[tuple[Delay, Delay], AfterValidator(_ordered)]


class ObjectiveOptions(Section):
    """The options of every task."""

    # options, with values to evaluate with
    training_only: ClassVar[dict[str, Any]] = {"guide": {}, "stagger": False}

    objectives: Objectives
    """The objectives to trade off; each is a weighted sum of reward terms."""
    shared: dict[str, float] = {}
    """Weighted reward terms that are added to every objective."""
    guide: dict[str, float] = {}
    """Weighted reward terms that are added to every objective in training only, such as those for
    posture: all policies learn from them, but returns and fronts do not count them."""
    reference_point: Point = None
    """Reference point of the hypervolume, one number per objective (None: the origin)."""
    episode_length: Count = 500
    """Control steps after which an episode is truncated."""
    stagger: bool = False
    """Start first episodes at random ages, so that time limits do not coincide."""

    def for_evaluation(self) -> Self:
        """Return the options to evaluate and show policies under, without those for training."""
        return self.model_copy(update=self.training_only)

    @field_validator("objectives")
    @classmethod
    def _plain_names(cls, objectives: Objectives) -> Objectives:
        return check_objectives(objectives)

    @field_validator("episode_length", "nconmax", "njmax", "reset_noise", check_fields=False)
    @classmethod
    def _bounded(cls, value: float, info: ValidationInfo) -> float:
        # a task that declares such an option anew drops the bounds of its type
        least = 0 if info.field_name == "reset_noise" else 1
        if value < least:
            raise ValueError(f"it must be at least {least}")
        return value

    @property
    def varies(self) -> bool:
        """Whether episodes of one policy differ at random."""
        return True

    def check_seeds(self, seeds: int) -> None:
        """Raise ValueError if several episodes of each policy would all be the same."""
        if seeds > 1 and not self.for_evaluation().varies:
            raise ValueError(
                "nothing in this task is random (task.reset_noise is 0 and task.randomization is "
                f"off), so {seeds} seeds would only repeat the same episode"
            )


class Randomization(Section):
    """Domain randomization; by default there is none.

    Ranges are of factors, drawn uniformly once for each world and kept in every episode.
    """

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
    """Change of the robot's velocity by a push, in m/s, in a random horizontal direction. A task's
    `base_body` names another robot than the one with the most actuators."""
    push_every: Count = 200
    """Mean number of control steps between pushes."""


class TaskOptions(ObjectiveOptions):
    """The options of every MuJoCo robot; a task sets its own defaults and may add options."""

    reset_noise: NonNegativeFloat = 0.0
    """Spread of the initial state: uniform on positions (m, rad), normal on velocities."""
    solver_iterations: Count | None = None
    """Iteration limit of the constraint solver (None: as in the MJCF)."""
    nconmax: Count = 48
    """Contact buffer of MuJoCo Warp, per world."""
    njmax: Count = 64
    """Constraint-row buffer of MuJoCo Warp, per world."""
    randomization: Randomization = Randomization()
    """Domain randomization."""
    design: dict[str, float] = {}
    """Values of the robot's design parameters, by name (docs/designs.md); others keep defaults."""

    @property
    def varies(self) -> bool:
        return self.reset_noise > 0 or self.randomization != Randomization()
