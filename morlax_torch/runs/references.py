"""Files that a run's config refers to: code that must be trusted, and a learned reward.

A run's folder has copies of them, so that it works on another computer.
"""

import glob
import os
import shutil
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .. import envs
from ..configuration.config import Config
from ..envs import MorlaxError, TaskOptions
from ..envs.errors import MorlaxWarning, shortened
from ..envs.naming import absolute, is_file, title
from ..host.files import (
    attempting,
    make_folder,
    read,
    write_file,
)

NAMES_CODE = {"env": "task", "scalarization": "utility"}
"""Fields of a config that may name a file or module, and a run's folder for a copy of it."""
LEARNED = "learned.pt"  # a run's own copy, which moves with its folder
MOST_BYTES = 20 * 2**20  # of the copies of a task; larger ones are not copied

_NAMED: dict[Path, str] = {}  # tasks of runs by folder, as a user has named them


def trust_code(config: dict[str, Any]) -> None:
    """Allow files to name the code of a config, in this process."""
    for name in _names(config):
        envs.trust(name)


def check_code(config: dict[str, Any], source: object) -> None:
    """Raise MorlaxError if the config of the file `source` names code that is not trusted."""
    for name in _names(config):
        envs.check_trusted(name, source)


def _names(config: dict[str, Any]) -> Iterator[str]:
    for field in NAMES_CODE:
        name = config.get(field)
        if isinstance(name, str):  # other values fail when the config is checked
            yield name


def check_moved(task: str, env: str, source: object) -> None:
    """Raise MorlaxError unless `env` can be where the `task` of the file `source` has moved."""
    if not is_file(task):
        raise MorlaxError(
            f"{source} is of task {task!r}, which is not FILE.py:CLASS: leave out --env (in Python "
            "env=...), which names a file that has moved."
        )
    if not is_file(env) or title(env) != title(task):
        raise MorlaxError(
            f"{source} is of the task {title(task)}, but --env (in Python env=...) is "
            f"{shortened(env)}: name FILE.py:{title(task)}."
        )


def name_task(folder: Path, env: str) -> None:
    """Let `env` be the task of the run in `folder`, and trust its code, in this process."""
    _NAMED[folder.resolve()] = absolute(env)
    envs.trust(env)


def named_task(folder: Path) -> str | None:
    """Return the task of the run in `folder`, if the user has named it."""
    return _NAMED.get(folder.resolve())


def copy_files(config: Config, folder: Path) -> None:
    """Copy the learned reward and the code that a config names, if any, into a run's folder.

    With the code come the models and other files that it names, if they are not too large.
    """
    task = config.task
    if isinstance(task, TaskOptions) and task.learned is not None:
        data = read(task.learned, "learned reward")
        write_file(folder / LEARNED, data)
    for field, copies in NAMES_CODE.items():
        name = getattr(config, field)
        file = Path(name.rpartition(":")[0])
        inside = file.is_relative_to(folder.resolve())
        if is_file(name) and not inside and edited(name, folder / copies) != []:
            more = [getattr(envs.get(name), "model_file", "")] if field == "env" else []
            _copy(file, more, folder / copies)


def _copy(file: Path, more: list[str], copies: Path) -> None:
    from ..envs.external import parts_of

    parts = parts_of(file, *more)
    with attempting(f"read {file} and its models"):
        if sum(part.stat().st_size for part in parts) > MOST_BYTES:
            return
    root = os.path.commonpath([part.parent for part in parts])
    shutil.rmtree(copies, ignore_errors=True)
    for part in parts:
        copy = copies / part.relative_to(root)
        make_folder(copy.parent)
        write_file(copy, read(part))


def edited(name: str, copies: Path) -> list[Path] | None:
    """Return the files of FILE.py:CLASS that differ from their copies (None: no copies)."""
    file, copy = Path(name.rpartition(":")[0]), _copy_of(name, copies)
    if copy is None:
        return None
    root = file.parents[len(copy.relative_to(copies).parts) - 1]
    pairs = [(root / part.relative_to(copies), part) for part in copies.rglob("*")]
    return [part for part, kept in pairs if kept.is_file() and not _same(part, kept)]


def _copy_of(name: str, copies: Path) -> Path | None:
    """Return the copy of FILE.py of FILE.py:CLASS, if there is one."""
    file = Path(name.rpartition(":")[0])
    return min(copies.rglob(glob.escape(file.name)), key=lambda path: len(path.parts), default=None)


def _same(one: Path, other: Path) -> bool:
    if not os.path.isfile(one) or one.stat().st_size != other.stat().st_size:
        return False
    return one.read_bytes() == other.read_bytes()


def localized(values: dict[str, Any], folder: Path, env: str | None = None) -> dict[str, Any]:
    """Return a config's plain values with the files of a run's folder.

    Code is that of the run's copy, unless the file that the config names is still there and
    unchanged, or the user has named the task, as `env` or by `name_task`.
    """
    values, task = dict(values), values.get("task")
    if isinstance(task, dict) and task.get("learned") and (folder / LEARNED).is_file():
        values["task"] = {**task, "learned": str(folder / LEARNED)}
    named = env or named_task(folder)
    for field, copies in NAMES_CODE.items():
        name = values.get(field)
        if not isinstance(name, str) or not is_file(name) or ":" not in name:
            continue
        if field == "env" and named is not None and title(named) == title(name):
            values[field] = absolute(named)
        else:
            with attempting(f"read the files of {name}"):
                values[field] = _located(field, absolute(name), (folder / copies).resolve())
    return values


def _located(field: str, name: str, copies: Path) -> str:
    """Return FILE.py:MEMBER, of the copy if FILE.py or a file that it needs was moved or edited."""
    file, _, member = name.rpartition(":")
    copy, changed = _copy_of(name, copies), edited(name, copies)
    if copy is None or not changed:
        return name
    if os.path.isfile(file):
        wish = f"name {file}:{member} with --env" if field == "env" else "start a new run"
        warnings.warn(
            f"{changed[0]} is not as it was when the run began, so the run uses its own copy in "
            f"{copies}: to use the edited one, {wish}.",
            MorlaxWarning,
            stacklevel=2,
        )
    return f"{copy}:{member}"
