"""Policies that can be explored: shipped ones, and the runs under ./runs."""

from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from ...envs import MorlaxError
from ...envs.errors import unknown
from ...envs.naming import GYMNASIUM, MJLAB, PLAYGROUND
from ...runs.loading import RUNS, SHIPPED, find_checkpoint, find_run, named_run, newest_runs


def _folders() -> dict[str, Path]:
    """Return the folders of the shipped policies, then those of the runs, newest first, by name."""
    shipped = sorted(folder.parent for folder in SHIPPED.glob("*/checkpoints"))
    return {folder.name: folder for folder in shipped} | {str(x): x for x in newest_runs(RUNS)}


def labels() -> dict[str, str]:
    """Return labels by name, shipped policies first; some end with why a run cannot be shown."""
    return {name: name + _reason(folder) for name, folder in _folders().items()}


def _reason(run: Path) -> str:
    try:
        with (run / "config.yaml").open() as config:
            line = next((line for line in config if line.startswith("env:")), "")
    except (OSError, UnicodeDecodeError):  # opening the run says why
        return ""
    task = line.removeprefix("env:").strip(" \n'\"")
    if task.startswith((PLAYGROUND, GYMNASIUM)):
        return " (no MuJoCo robot)"
    return " (needs mjlab)" if task.startswith(MJLAB) and find_spec("mjlab") is None else ""


def first() -> str:
    """Return the default choice: the first shipped policy, or else the latest run."""
    if folders := _folders():
        return next(iter(folders))
    raise MorlaxError(
        "there is nothing to explore yet: name the folder of a run, or train one "
        "(morlax train --env cheetah --max-seconds 60)."
    )


class Choice(NamedTuple):
    """A checkpoint to show, and the other checkpoints of its run."""

    run: str  # a folder, a shipped name, or a checkpoint file outside any run
    checkpoint: str  # its name: "best"
    files: dict[str, Path]  # the checkpoints of the run by name

    @property
    def file(self) -> Path:
        return self.files[self.checkpoint]


def choose(run: str, checkpoint: str | None = None) -> Choice:
    """Find a checkpoint of a run, or raise MorlaxError.

    `checkpoint` is its name, such as "latest" (None: the best one, or the checkpoint file `run`).
    """
    run = str(named_run(run))
    file = find_checkpoint(run)
    if Path(run).is_file():
        if file.parent.name != "checkpoints":
            return Choice(run, file.stem, {file.stem: file})
        run = str(find_run(run))
    files = {file.stem: file for file in sorted(file.parent.glob("*.pt"))}
    name = checkpoint or file.stem
    if name not in files:
        raise unknown("checkpoint", name, files)
    return Choice(run, name, files)
