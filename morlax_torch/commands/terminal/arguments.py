"""The command line of `train`: options over a file, a task's config or an earlier run."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ... import envs
from ...configuration.config import MAY_CHANGE, Config, differences
from ...envs import MorlaxError
from ...envs.naming import is_file
from ...envs.worlds.options import Section
from ...host.torchrun import FIRST, MAY_RESTART, launch
from .startup import program
from .task_arguments import (
    CommandLine,
    asks_for_help,
    draft,
    placed,
)

if TYPE_CHECKING:
    from ...runs.run import Run

ABOUT = "Train one hypernetwork to hold a whole Pareto front of policies."


class Command(Section):
    config: Path | None = None
    """A YAML file of changes to the task's config."""
    output: Path | None = None
    """Folder of the run (None: runs/<task>/<time>-<seed>)."""
    resume: Path | None = None
    """Continue the run in this folder, or in the newest (runs/TASK or latest); only limits,
    evaluation, device and backend may change. On a CPU and with a limit in steps, the result equals
    that of an uninterrupted run bit for bit; on CUDA they differ as two runs of one seed do, by the
    order of floating-point sums."""
    trust: bool = False
    """Let the resumed run import the Python files and modules that it names."""


def read(arguments: Sequence[str]) -> "tuple[Config, Run | None, Path | None]":
    """Read the command line over the config of the file, task or run that it names."""
    line = CommandLine(program("train"), ABOUT, Command)
    early = line.early(arguments, "--resume", "--output")
    for name in ("config", "output"):
        if early.resume and getattr(early, name):
            raise MorlaxError(
                f"--resume continues a run with its own config, in its own folder: "
                f"leave out --{name}."
            )
    if asks_for_help(arguments) and not (early.env or early.config or early.resume):
        line.help_for_any_task(early.device)
    run = _run(Path(early.resume)) if early.resume else None
    if run and early.env:
        envs.get(early.env)  # the user names this code
    moved = early.env if early.env and is_file(early.env) else None
    below = run.config("--trust" in arguments, moved) if run else draft(early)
    own, values = line.parse(arguments, below)
    config = placed(values, below if run else None)
    found = differences(below, config) if run else []
    if found:
        raise MorlaxError(
            f"a resumed run keeps its config ({'; '.join(found)}): leave that out, or start a new "
            f"run. Only {', '.join(MAY_CHANGE)} may change."
        )
    output = own["output"]
    if MAY_RESTART:
        if run is None and output is None:
            raise MorlaxError("torchrun --max-restarts needs --output FOLDER, to go on from there.")
        if output is not None and _was_begun(output):
            return config, _run(output), None
    return config, run, output


def _was_begun(output: Path) -> bool:
    """Return whether this launch of `torchrun` began the run before it restarted.

    Raises:
        MorlaxError: another launch did. Only the first process knows, and ends the others.
    """
    if not (output / "config.yaml").is_file():
        return False
    if FIRST:
        from ...runs import checkpoint
        from ...runs.run import taken

        if checkpoint.load(output / "checkpoints" / "latest.pt").progress.launch != launch():
            raise taken(output)
    return True


def _run(folder: Path) -> "Run":
    from ...runs.run import Run  # imports torch

    return Run.open(folder)
