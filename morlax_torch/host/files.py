"""Whole files and folders: read at once, and written atomically, so never half-written."""

import csv
import errno
import glob
import io
import os
import secrets
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from ..envs.errors import MorlaxError, line

AnyPath = str | os.PathLike[str]
RUNS = Path("runs")  # where training writes


@contextmanager
def attempting(task: str, *others: type[Exception]) -> Iterator[None]:
    """Turn errors of the system, and others, into a MorlaxError: "cannot write f: disk full."."""
    try:
        yield
    except (OSError, *others) as error:
        reason = getattr(error, "strerror", None) or line(error)
        raise MorlaxError(f"cannot {task}: {reason.rstrip('.')}.") from None


def read(path: AnyPath, what: str = "file") -> bytes:
    """Read a whole file; error messages name the kind of file, such as "config"."""
    path = Path(path)
    with attempting(f"read the {what} {path}"):
        if not path.exists():
            raise MorlaxError(f"there is no {what} {path}.")
        if not path.is_file():
            raise MorlaxError(f"cannot read the {what} {path}: it is not a regular file.")
        return path.read_bytes()


@contextmanager
def replacing(path: AnyPath) -> Iterator[IO[bytes]]:
    """Open a temporary file that replaces `path` once it is complete and on disk.

    A symbolic link stays, and its target is replaced. New files get the permissions of the umask.
    """
    with attempting(f"write {path}"):
        target = Path(os.path.realpath(path))
        if target.exists() and not target.is_file():
            raise MorlaxError(f"cannot write {path}: it is not a regular file, name another one.")
        draft = target.with_name(_draft())
        try:
            with draft.open("xb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            draft.replace(target)
        finally:
            draft.unlink(missing_ok=True)


def write_file(path: AnyPath, content: str | bytes | memoryview) -> None:
    with replacing(path) as file:
        file.write(content.encode() if isinstance(content, str) else content)


def write_rows(path: AnyPath, rows: Iterable[Iterable]) -> None:
    text = io.StringIO()
    csv.writer(text).writerows(rows)
    write_file(path, text.getvalue())


class Taken(MorlaxError):
    """A folder to make is in use."""


@contextmanager
def making(folder: Path) -> Iterator[Path]:
    """Make an empty temporary folder that becomes `folder` once it is complete."""
    taken = Taken(f"{folder} exists already: choose another folder.")
    with attempting(f"make {folder}"):
        used = folder.exists() and (not folder.is_dir() or any(folder.iterdir()))
        if used or (folder.exists() and folder.samefile(Path.cwd())):
            raise taken
        draft = folder.with_name(f".{folder.name}{_draft()}")
        remove_drafts(folder.parent, f".{folder.name}")
        draft.mkdir(parents=True)
        try:
            yield draft
            draft.replace(folder)
        except OSError as error:
            raise taken if error.errno in (errno.EEXIST, errno.ENOTEMPTY) else error from None
        finally:
            shutil.rmtree(draft, ignore_errors=True)


def make_folder(folder: Path) -> None:
    with attempting(f"make {folder}"):
        folder.mkdir(parents=True, exist_ok=True)


def _draft() -> str:
    return f".{os.getpid()}.{secrets.token_hex(8)}.tmp"


def remove_drafts(folder: Path, prefix: str = "") -> None:
    """Remove temporary files and folders that killed processes have left in a folder."""
    for draft in folder.glob(f"{glob.escape(prefix)}.*.tmp"):
        process = draft.name.removeprefix(prefix).split(".")[1]
        if not process.isdecimal() or runs(int(process)):
            continue
        if draft.is_dir():
            shutil.rmtree(draft, ignore_errors=True)
        else:
            draft.unlink(missing_ok=True)


def runs(process: int) -> bool:
    try:
        os.kill(process, 0)  # sends no signal, only asks
    except OSError as error:
        return not isinstance(error, ProcessLookupError)  # it may belong to another user
    return True


def unused(path: Path) -> Path:
    """Return `path`, with a number appended if it exists."""
    candidate, number = path, 2
    while candidate.exists():
        candidate, number = path.with_name(f"{path.name}-{number}"), number + 1
    return candidate


def newest_runs(folder: Path) -> list[Path]:
    """Return runs with a checkpoint, at most three levels below `folder`, the newest first."""
    times: dict[Path, float] = {}
    levels = ("*", "*/*", "*/*/*")  # a task's name may have a slash
    for file in (x for level in levels for x in folder.glob(f"{level}/checkpoints/*.pt")):
        with suppress(OSError):  # deleted meanwhile, or not readable
            run = file.parent.parent
            times[run] = max(times.get(run, 0.0), file.stat().st_mtime)
    return sorted(times, key=times.__getitem__, reverse=True)


def task_of(run: Path) -> str:
    """Return the task that a run's config.yaml names, or "" if opening the run would say why."""
    with suppress(OSError, UnicodeDecodeError), (run / "config.yaml").open() as config:
        named = next((row for row in config if row.startswith("env:")), "")
        return named.removeprefix("env:").strip(" \n'\"")
    return ""
