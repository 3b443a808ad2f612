"""Whole files and folders: read at once, and written atomically, so never half-written."""

import errno
import glob
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from ..envs import MorlaxError

AnyPath = str | os.PathLike[str]

DRAFT = ".tmp"


@contextmanager
def attempting(task: str) -> Iterator[None]:
    """Turn an error of the system into a MorlaxError, such as "cannot write f.csv: disk full."."""
    try:
        yield
    except OSError as error:
        raise MorlaxError(f"cannot {task}: {error.strerror or error}.") from None
    except ValueError:
        if "\0" not in task:
            raise
        task = task.replace("\0", r"\0")
        raise MorlaxError(f"cannot {task}: a path cannot contain NUL.") from None


def exists(path: AnyPath) -> bool:
    """Return whether a path exists, or raise MorlaxError if the system cannot say."""
    with attempting(f"use {path}"):
        return Path(path).exists()


def is_file(path: AnyPath) -> bool:
    """Return whether a path is a regular file; raises as `exists`."""
    with attempting(f"use {path}"):
        return Path(path).is_file()


def is_folder(path: AnyPath) -> bool:
    """Return whether a path is a folder; raises as `exists`."""
    with attempting(f"use {path}"):
        return Path(path).is_dir()


def read(path: AnyPath, what: str = "file") -> bytes:
    """Read a whole file; error messages name the kind of file, such as "config".

    Raises:
        MorlaxError: the file is missing, is a folder, device or pipe, or cannot be read.
    """
    path = Path(path)
    with attempting(f"read the {what} {path}"):
        if path.exists() and not path.is_file():
            raise MorlaxError(f"cannot read the {what} {path}: it is not a regular file.")
        try:
            return path.read_bytes()
        except FileNotFoundError:
            raise MorlaxError(f"there is no {what} {path}.") from None


@contextmanager
def replacing(path: AnyPath) -> Iterator[IO[bytes]]:
    """Open a temporary file that replaces `path` once it is complete and on disk.

    A symbolic link stays, and its target is replaced. New files get the permissions of the umask.

    Raises:
        MorlaxError: it cannot be written, or is a folder, device or pipe; `path` is unchanged.
    """
    temporary = None
    with attempting(f"write {path}"):
        target = Path(os.path.realpath(path))
        if target.exists() and not target.is_file():
            raise MorlaxError(f"cannot write {path}: it is not a regular file, name another one.")
        draft = target.with_name(_draft())
        try:
            with open(draft, "xb") as file:
                temporary = draft
                yield file
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(target)
        finally:
            if temporary is not None:
                temporary.unlink(missing_ok=True)


def write_file(path: AnyPath, content: str | bytes | memoryview) -> None:
    """Write a whole file atomically; raises as `replacing`."""
    with replacing(path) as file:
        file.write(content.encode() if isinstance(content, str) else content)


class Taken(MorlaxError):
    """A folder to make is in use."""


@contextmanager
def making(folder: Path) -> Iterator[Path]:
    """Make an empty temporary folder that becomes `folder` once it is complete.

    Raises:
        Taken: `folder` is not empty, or another program has made it meanwhile.
        MorlaxError: it cannot be made or written.
    """
    taken = Taken(f"{folder} exists already: choose another folder.")
    if exists(folder) and not (folder.is_dir() and _is_unused(folder)):
        raise taken
    draft = folder.with_name(f".{folder.name}{_draft()}")
    try:
        with attempting(f"make {folder}"):
            remove_drafts(folder.parent, f".{folder.name}")
            draft.mkdir(parents=True)
            yield draft
            try:
                draft.replace(folder)
            except OSError as error:
                raise taken if error.errno in (errno.EEXIST, errno.ENOTEMPTY) else error from None
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def make_folder(folder: Path) -> None:
    """Make a folder and its parents if they do not exist, or raise MorlaxError."""
    with attempting(f"make {folder}"):
        folder.mkdir(parents=True, exist_ok=True)


def _is_unused(folder: Path) -> bool:
    return not any(folder.iterdir()) and not folder.samefile(Path.cwd())


def _draft() -> str:
    return f".{os.getpid()}.{secrets.token_hex(8)}{DRAFT}"


def remove_drafts(folder: Path, prefix: str = "") -> None:
    """Remove temporary files and folders that killed processes have left in a folder."""
    for draft in folder.glob(f"{glob.escape(prefix)}.*{DRAFT}"):
        process = draft.name.removeprefix(prefix).split(".")[1]
        if process.isdecimal() and not runs(int(process)):
            if draft.is_dir():
                shutil.rmtree(draft, ignore_errors=True)
            else:
                draft.unlink(missing_ok=True)


def runs(process: int) -> bool:
    try:
        os.kill(process, 0)  # sends no signal, only asks
    except ProcessLookupError:
        return False
    except OSError:  # it runs, and belongs to another user
        pass
    return True


def unused(path: Path) -> Path:
    """Return `path`, with a number appended if it exists."""
    candidate, number = path, 2
    while exists(candidate):
        candidate, number = path.with_name(f"{path.name}-{number}"), number + 1
    return candidate
