"""Numbers by name on the command line, such as requirements: --at-least run=2000."""

import math
from collections.abc import Sequence
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
    least: dict[str, float] = {}
    most: dict[str, float] = {}
    rows = [(text, "=", "--at-least run=2000", least, max) for text in at_least]
    rows += [(text, "=", "--at-most power=60", most, min) for text in at_most]
    for text in constrain:
        if "<=" in text:
            rows.append((text, "<=", "--constrain 'power <= 60'", most, min))
        else:
            rows.append((text, ">=", "--constrain 'run >= 2000'", least, max))
    for text, sign, example, levels, strictest in rows:
        name, level = _required(text, sign, example)
        levels[name] = strictest(level, levels.get(name, level))
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
