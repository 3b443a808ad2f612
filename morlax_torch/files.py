"""Atomic files: either unchanged or complete, never half-written."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from .envs import MorlaxError


@contextmanager
def replacing(path: Path) -> Iterator[IO[bytes]]:
    """Open a temporary file that replaces `path` once it is complete and on disk.

    A symbolic link stays, and its target is replaced. New files get the permissions of the umask.

    Raises:
        MorlaxError: it cannot be written, or is a folder, device or pipe; `path` is unchanged.
    """
    try:
        target = Path(os.path.realpath(path))
    except ValueError:
        raise MorlaxError(f"cannot write {str(path)!r}: a path cannot contain NUL.") from None
    temporary = None
    try:
        if target.exists() and not target.is_file():
            raise MorlaxError(f"cannot write {path}: it is not a regular file, name another one.")
        draft = target.with_name(f".{secrets.token_hex(8)}.tmp")
        with open(draft, "xb") as file:
            temporary = draft
            yield file
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(target)
    except OSError as error:
        raise MorlaxError(f"cannot write {path}: {error.strerror or error}.") from None
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def unused(path: Path) -> Path:
    """Return `path`, with a number appended if it exists."""
    candidate, number = path, 2
    while candidate.exists():
        candidate, number = path.with_name(f"{path.name}-{number}"), number + 1
    return candidate
