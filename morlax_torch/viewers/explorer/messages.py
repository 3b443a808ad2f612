"""What browsers may ask for, as JSON: anything else is ignored."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, NonNegativeInt, TypeAdapter, ValidationError

LONGEST = 400  # characters of a name, and numbers in a trade-off
Name = Annotated[str, Field(max_length=LONGEST)]


class Message(BaseModel):
    """A message of a browser; numbers are finite. Values are clamped to their range."""

    model_config = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False, frozen=True)


class Steer(Message):
    """Give the selected robot a trade-off, which is scaled to sum to one."""

    act: Literal["steer"]
    weights: Annotated[list[float], Field(max_length=LONGEST)]


class Tell(Message):
    """Set one number of the command of all robots."""

    act: Literal["tell"]
    index: NonNegativeInt
    value: float


class Nudge(Message):
    """Change one number of the command of all robots."""

    act: Literal["nudge"]
    index: NonNegativeInt
    change: float


class Reshape(Message):
    """Set one design parameter of all robots' body."""

    act: Literal["reshape"]
    index: NonNegativeInt
    value: float


class Pause(Message):
    act: Literal["pause"]
    on: bool


class Pace(Message):
    """Set the playback speed; 1 is real time."""

    act: Literal["pace"]
    value: float


class Press(Message):
    """Press a button."""

    act: Literal["press"]
    name: (
        Literal["reset", "push", "add", "remove", "free", "export", "card", "measure"]
        | Literal["find", "skip", "use", "again", "leave"]
    )


class Select(Message):
    """Steer another robot."""

    act: Literal["select"]
    robot: NonNegativeInt


class Open(Message):
    """Show another run or checkpoint; no checkpoint means the best."""

    act: Literal["open"]
    run: Name
    checkpoint: Name | None


class Require(Message):
    """Require the return of an objective, or a quantity, whose indices follow the objectives'.

    A level of null requires nothing.
    """

    act: Literal["require"]
    index: NonNegativeInt
    level: float | None


class Maximize(Message):
    act: Literal["maximize"]
    index: NonNegativeInt


class Answer(Message):
    """Prefer A (0) or B (1)."""

    act: Literal["answer"]
    preferred: Literal[0, 1]


class Bookmark(Message):
    """Keep the selected robot's trade-off under a name."""

    act: Literal["bookmark"]
    name: Name


Robots = Steer | Tell | Nudge | Reshape | Pause | Pace | Press | Select | Open
Request = Robots | Require | Maximize | Answer | Bookmark
_READER: TypeAdapter[Request] = TypeAdapter(Annotated[Request, Field(discriminator="act")])


def accepted(message: str | bytes) -> Request | None:
    """Return the request in a browser's message; None if the message is not one of the page's."""
    try:
        return _READER.validate_json(message)
    except (ValidationError, RecursionError):
        return None
