"""The exception for mistakes that a user can fix, and its messages."""

import difflib
import re
import reprlib
import traceback
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from importlib import metadata
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

LONGEST = 200  # characters of a user's value in a message
MOST_FINDINGS = 5  # mistakes listed in one message

M = TypeVar("M", bound=BaseModel)
_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = LONGEST
_SHORT.maxlevel = 3


class MorlaxError(Exception):
    """A mistake that the user can fix; the message says what is wrong and what to do.

    Commands print it as one sentence and exit with status 2.
    """


class NotFinite(MorlaxError):
    """A number of a learner's state is infinite or NaN."""


class NotInstalled(MorlaxError):
    """A library that something needs is missing or too old."""


class MorlaxWarning(UserWarning):
    """What a user should know, in one sentence, which commands print."""


def warn_user(sentence: str) -> None:
    """Give a `MorlaxWarning` from the caller of the function that calls this."""
    warnings.warn(sentence, MorlaxWarning, stacklevel=3)


def installation(extra: str) -> str:
    """Return the commands that install one of our extras, from PyPI and from a checkout."""
    return f"pip install 'morlax-torch[{extra}]', or in a checkout pip install '.[{extra}]'"


def require(name: str, package: str, least: str, extra: str, note: str = "") -> None:
    """Check that a library, PyPI's `package`, is installed by our `extra` and recent enough."""
    try:
        version = metadata.version(package)
    except metadata.PackageNotFoundError:
        version = "none"
    if [*map(int, re.findall(r"\d+", version)[:2])] < [*map(int, least.split("."))]:
        raise NotInstalled(
            f"{name} {least} or later is needed, but {version} is installed: {installation(extra)}"
            f"{note}."
        )


def shortened(value: object) -> str:
    """Return `repr(value)` in one line, shortened if it is long or deeply nested."""
    return " ".join(_SHORT.repr(value).split())


def unknown(kind: str, name: str, known: Iterable[str]) -> MorlaxError:
    """Return the error for a `name` that is not `known`; it suggests the nearest one."""
    names = sorted(known)
    near = difflib.get_close_matches(name[:LONGEST], names, n=1)
    guess = f": did you mean {near[0]!r}?" if near else "."
    listed = f" Known: {', '.join(names)}." if names else ""
    return MorlaxError(f"unknown {kind} {shortened(name)}{guess}{listed}")


def line(error: BaseException) -> str:
    """Return what an error says in one line."""
    return " ".join(str(error).split())


def words(error: BaseException) -> str:
    """Return an error of a user's own code, with its type, in one line."""
    return f"{type(error).__name__}: {line(error)}"


@contextmanager
def user_code(sentence: str, file: str | None = None) -> Iterator[None]:
    """Turn any error of a user's own code, but a lack of memory, into a sentence.

    It names the last line of `file` that the error came through.
    """
    try:
        yield
    except (MorlaxError, MemoryError):
        raise
    except (Exception, SystemExit) as error:
        if type(error).__name__ == "OutOfMemoryError":  # torch's, which is not imported here
            raise
        frames = traceback.extract_tb(error.__traceback__)
        lines = [frame.lineno for frame in frames if frame.filename == file]
        where = f" ({file}, line {lines[-1]})" if lines else ""
        raise MorlaxError(f"{sentence}: {words(error)}{where}") from error


def validated(model: type[M], values: Any, source: str = "", context: object = None) -> M:
    """Return values as a model, or raise MorlaxError that begins with their `source`."""
    try:
        return model.model_validate(values, context=context)
    except ValidationError as error:
        findings = error.errors()
    sentences = [_sentence(finding, model) for finding in findings[:MOST_FINDINGS]]
    if len(findings) > MOST_FINDINGS:
        sentences.append(f"There are {len(findings) - MOST_FINDINGS} more such mistakes.")
    raise MorlaxError(source + " ".join(sentences))


def _sentence(finding: Mapping[str, Any], model: type[BaseModel]) -> str:
    """Turn a finding of pydantic into a plain sentence that suggests the nearest known key."""
    path, value = list(finding["loc"]), finding["input"]
    if finding["type"] == "extra_forbidden":
        *path, last = path
        owner: Any = model
        for part in path:
            owner = owner.model_fields[part].annotation
        section = f"{'.'.join(path)} key" if path else "key"
        return str(unknown(section, str(last), getattr(owner, "model_fields", ())))
    input_value = "" if isinstance(value, dict) else f" (given: {shortened(value)})"
    key = ".".join(" ".join(str(part)[:LONGEST].split()) for part in path)
    reason = finding["msg"].removeprefix("Value error, ")
    return f"{key}: {reason}{input_value}." if key else reason
