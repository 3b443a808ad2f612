"""The one exception for mistakes that a user can mend, and the words for them."""

import difflib
from collections.abc import Iterable

from pydantic import ValidationError


class MorlaxError(Exception):
    """Something is wrong that its user can put right; the message says what, and how.

    The commands print it as one sentence and exit with status 2.
    """


def unknown(kind: str, name: str, known: Iterable[str]) -> MorlaxError:
    """The error for a `name` that is none of the `known` ones: it offers the nearest."""
    known = sorted(known)
    near = difflib.get_close_matches(name, known, n=1)
    guess = f": did you mean {near[0]!r}?" if near else "."
    return MorlaxError(f"unknown {kind} {name!r}{guess} Known: {', '.join(known)}.")


def explained(error: ValidationError, model: type) -> MorlaxError:
    """pydantic's findings in plain sentences, an unknown key with the nearest right one."""
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
