"""A run's own copy of its learned reward, which moves with its folder."""

from pathlib import Path
from typing import Any

from ..configuration.config import Config
from ..envs import TaskOptions
from ..files import read, replacing

NAME = "learned.pt"  # in the run's folder


def copy_reward(config: Config, folder: Path) -> None:
    """Copy the learned reward that the config names, if any, into a run's folder.

    Raises:
        MorlaxError: it cannot be read or written.
    """
    task = config.task
    if isinstance(task, TaskOptions) and task.learned is not None:
        data = read(task.learned, "learned reward")
        with replacing(folder / NAME) as file:
            file.write(data)


def localized(values: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return a config's plain values, with the learned reward of a run's folder if it has one."""
    task = values.get("task")
    if isinstance(task, dict) and task.get("learned") and (folder / NAME).is_file():
        return {**values, "task": {**task, "learned": str(folder / NAME)}}
    return values
