"""The one exception for mistakes that a user can mend."""

import difflib
from collections.abc import Iterable


class MorlaxError(Exception):
    """Something is wrong that its user can put right; the message says what, and how.

    The commands print it as one sentence and exit with status 2.
    """


def unknown(kind: str, name: str, known: Iterable[str]) -> MorlaxError:
    """The error for a `name` that is none of the `known` ones: it offers the nearest."""
    known = sorted(known)
    near = difflib.get_close_matches(name, known, n=1)
    guess = f"did you mean {near[0]!r}? " if near else ""
    return MorlaxError(f"unknown {kind} {name!r}: {guess}Known: {', '.join(known)}.")
