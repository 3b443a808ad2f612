"""What browsers may ask for, as JSON: anything else is ignored."""

from functools import reduce
from operator import or_
from typing import Annotated, Any, Literal

from pydantic import (
    ConfigDict,
    Field,
    NonNegativeInt,
    TypeAdapter,
    ValidationError,
    create_model,
)

LONGEST = 400  # characters of a name, and numbers in a trade-off
Request = dict[str, Any]  # "act", and the fields of that act
Name: Any = Annotated[str, Field(max_length=LONGEST)]
Button = Literal[
    *("reset", "push", "add", "remove", "free", "export", "card", "measure"),
    *("find", "skip", "use", "again", "leave"),
]
ACTS: dict[str, dict[str, Any]] = {
    # the selected robot's trade-off, which is scaled to sum to one
    "steer": {"weights": Annotated[list[float], Field(max_length=LONGEST)]},
    # numbers of all robots' command and design parameters of their body, clamped to their limits
    "tell": {"index": NonNegativeInt, "value": float},
    "nudge": {"index": NonNegativeInt, "change": float},
    "reshape": {"index": NonNegativeInt, "value": float},
    "pause": {"on": bool},
    "pace": {"value": float},  # playback speed; 1 is real time
    "press": {"name": Button},
    "select": {"robot": NonNegativeInt},  # steer another robot
    "open": {"run": Name, "checkpoint": Name | None},  # no checkpoint means the best
    # returns of objectives, then quantities; the level is clamped to the front's range
    "require": {"index": NonNegativeInt, "level": float | None},
    "maximize": {"index": NonNegativeInt},
    "answer": {"preferred": Literal[0, 1]},  # A or B
    "bookmark": {"name": Name},  # of the selected robot's trade-off
}
_STRICT = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)
_model: Any = create_model  # a type checker cannot follow fields that a table has
_MODELS = [
    _model(act, __config__=_STRICT, act=(Literal[act], ...), **fields)
    for act, fields in ACTS.items()
]
_READER: TypeAdapter[Any] = TypeAdapter(reduce(or_, _MODELS))


def accepted(message: str | bytes) -> Request | None:
    """Return the request in a browser's message; None if the message is not one of the page's."""
    try:
        return _READER.validate_json(message).model_dump()
    except (ValidationError, RecursionError):
        return None
