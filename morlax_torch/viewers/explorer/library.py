"""Which policies there are to explore: those that ship, and the runs under ./runs."""

from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from ...envs import MorlaxError
from ...envs.errors import unknown
from ...runs.loading import SHIPPED, find_checkpoint, find_run

RUNS = Path("runs")


def shipped() -> list[str]:
    """The names of the policies that ship."""
    return sorted(folder.parent.name for folder in SHIPPED.glob("*/checkpoints"))


def trained() -> list[str]:
    """The folders of runs under ./runs that hold a checkpoint, the latest first."""
    times: dict[str, float] = {}
    for depth in ("*", "*/*"):
        for file in RUNS.glob(f"{depth}/checkpoints/*.pt"):
            run = str(file.parent.parent)
            with suppress(FileNotFoundError):  # somebody tidies up
                times[run] = max(times.get(run, 0.0), file.stat().st_mtime)
    return sorted(times, key=times.__getitem__, reverse=True)


def first() -> str:
    """What to show when nobody said: the first policy that ships, else the latest run.

    Raises:
        MorlaxError: there is neither.
    """
    for run in [*shipped(), *trained()]:
        return run
    raise MorlaxError(
        "there is nothing to explore yet: name the folder of a run, or train one here "
        "(python -m morlax_torch.train --env cheetah --max-seconds 60)."
    )


class Choice(NamedTuple):
    """A checkpoint to show, and what may be shown instead."""

    run: str  # a folder, a shipped name, or a checkpoint file that lies in no run
    checkpoint: str  # its name: "best"
    files: dict[str, Path]  # the checkpoints of the run by name

    @property
    def file(self) -> Path:
        return self.files[self.checkpoint]


def choose(run: str, checkpoint: str | None = None) -> Choice:
    """A checkpoint of a run by name, by default the best; `run` may be one's file instead.

    Raises:
        MorlaxError: no such run, or no such checkpoint.
    """
    file = find_checkpoint(run)
    if Path(run).is_file() and file.parent.name != "checkpoints":
        return Choice(run, file.stem, {file.stem: file})
    if Path(run).is_file():
        run = str(find_run(run))
    files = {file.stem: file for file in sorted(file.parent.glob("*.pt"))}
    name = checkpoint or file.stem
    if name not in files:
        raise unknown("checkpoint", name, files)
    return Choice(run, name, files)
