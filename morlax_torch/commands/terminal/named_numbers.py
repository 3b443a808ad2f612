"""Numbers by name on the command line, such as requirements: --at-least run=2000."""

import math
from collections.abc import Callable, Sequence
from typing import Annotated

import tyro

from ...envs import MorlaxError

AtLeast = Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="run=2000")]
AtMost = Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="power=60")]


def limits(
    at_least: Sequence[str], at_most: Sequence[str], constrain: Sequence[str] = ()
) -> tuple[dict[str, float], dict[str, float]]:
    """Return the least and the largest values by name, the strictest of each.

    Raises:
        MorlaxError: a text is not a requirement.
    """
    above = [text for text in constrain if "<=" not in text]
    below = [text for text in constrain if "<=" in text]
    least = _strictest(
        [_required(text, "=", "--at-least run=2000") for text in at_least]
        + [_required(text, ">=", "--constrain 'run >= 2000'") for text in above],
        max,
    )
    most = _strictest(
        [_required(text, "=", "--at-most power=60") for text in at_most]
        + [_required(text, "<=", "--constrain 'power <= 60'") for text in below],
        min,
    )
    return least, most


def numbers(text: str, example: str) -> dict[str, float]:
    """Read numbers by name, such as "thigh=0.4,calf=0.3".

    Raises:
        MorlaxError: the text is something else; the sentence shows the example.
    """
    return dict(_required(part, "=", example, "does not name numbers") for part in text.split(","))


def _required(
    text: str, sign: str, example: str, problem: str = "is not a requirement"
) -> tuple[str, float]:
    name, found, level = text.partition(sign)
    try:
        if not found or not name.strip() or not math.isfinite(float(level)):
            raise ValueError
        return name.strip(), float(level)
    except ValueError:
        raise MorlaxError(f"{text!r} {problem}: write for example {example}.") from None


def _strictest(
    levels: Sequence[tuple[str, float]], strictest: Callable[[float, float], float]
) -> dict[str, float]:
    found: dict[str, float] = {}
    for name, level in levels:
        found[name] = strictest(level, found.get(name, level))
    return found
