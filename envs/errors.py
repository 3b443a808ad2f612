"""The exception for mistakes that a user can fix, and its messages."""

import difflib
from collections.abc import Iterable

from pydantic import ValidationError


class MorlaxError(Exception):
    """A mistake that the user can fix; the message says what is wrong and what to do.

    Commands print it as one sentence and exit with status 2.
    """


def unknown(kind: str, name: str, known: Iterable[str]) -> MorlaxError:
    """Return the error for a `name` that is not `known`; it suggests the nearest one."""
    known = sorted(known)
    near = difflib.get_close_matches(name, known, n=1)
    guess = f": did you mean {near[0]!r}?" if near else "."
    return MorlaxError(f"unknown {kind} {name!r}{guess} Known: {', '.join(known)}.")


def explained(error: ValidationError, model: type) -> MorlaxError:
    """Turn pydantic's findings into plain sentences that suggest the nearest known keys."""
    sentences = []
    for finding in error.errors():
        key = ".".join(str(part) for part in finding["loc"])
        if finding["type"] == "extra_forbidden":
            *path, last = finding["loc"]
            owner = model
            for part in path:
                owner = owner.model_fields[part].annotation
            section = f"{'.'.join(map(str, path))} key" if path else "key"
            sentences.append(str(unknown(section, str(last), owner.model_fields)))
        else:
            reason = finding["msg"].removeprefix("Value error, ")
            value = finding["input"]
            given = "" if isinstance(value, dict) else f" (given: {value!r})"
            sentences.append(f"{key}: {reason}{given}." if key else f"{reason}")
    return MorlaxError(" ".join(sentences))
