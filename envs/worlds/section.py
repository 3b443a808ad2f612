"""A group of options that refuses unknown keys and unusable numbers."""

from collections.abc import Iterable
from typing import Annotated, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator

LARGEST = 1e9  # of any number, in size: squares of it are still finite in float32

Count = Annotated[int, Field(gt=0, le=1_000_000)]


class Section(BaseModel):
    """A group of options.

    Raises:
        ValidationError: a key is unknown, or a number is not finite or larger than LARGEST.
    """

    model_config = ConfigDict(
        extra="forbid", frozen=True, use_attribute_docstrings=True, allow_inf_nan=False
    )

    @field_validator("*", mode="before")
    @classmethod
    def _no_truth_for_numbers(cls, value: object, info: ValidationInfo) -> object:
        if isinstance(value, bool) and info.field_name is not None:
            kind = cls.model_fields[info.field_name].annotation
            if bool not in (kind, *get_args(kind)):
                raise ValueError("true and false are neither numbers nor names")
        return value

    @field_validator("*")
    @classmethod
    def _moderate(cls, value: object) -> object:
        for number in _floats(value):
            if abs(number) > LARGEST:
                raise ValueError(f"{number:g} is too large: use at most {LARGEST:g} in size")
        return value


def _floats(value: object) -> Iterable[float]:
    if isinstance(value, float):
        yield value
    elif isinstance(value, dict):
        for part in value.values():
            yield from _floats(part)
    elif isinstance(value, tuple | list):
        for part in value:
            yield from _floats(part)
