"""Files that a run's config refers to: code that must be trusted, and a learned reward."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .. import envs
from ..configuration.config import Config
from ..envs import TaskOptions
from ..files import read, write_file

NAMES_CODE = ("env", "scalarization")  # fields of a config that may name a file or module
LEARNED = "learned.pt"  # a run's own copy, which moves with its folder


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


def copy_reward(config: Config, folder: Path) -> None:
    """Copy the learned reward that the config names, if any, into a run's folder."""
    task = config.task
    if isinstance(task, TaskOptions) and task.learned is not None:
        data = read(task.learned, "learned reward")
        write_file(folder / LEARNED, data)


def localized(values: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return a config's plain values, with the learned reward of a run's folder if it has one."""
    task = values.get("task")
    if isinstance(task, dict) and task.get("learned") and (folder / LEARNED).is_file():
        return {**values, "task": {**task, "learned": str(folder / LEARNED)}}
    return values
