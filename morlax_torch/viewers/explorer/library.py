"""Policies that can be explored, shipped or of the runs under ./runs, and files written of them."""

import shlex
import signal
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

from ...envs.errors import unknown
from ...envs.naming import GYMNASIUM, MJLAB, runs_code
from ...evaluation.requirements import Choice as Chosen
from ...evaluation.requirements import shown
from ...host.files import RUNS, newest_runs, task_of, write_file
from ...networks.policy import Policy
from ...runs import loading
from ...runs.checkpoint import folder_of, front_path
from ...runs.progress import FRONTS
from ...runs.references import named_task
from ...runs.run import is_training

POLICY, CARD = "policy.onnx", "decision.html"
BODY = "body.pt"  # policies of a body that is not the checkpoint's


def labels() -> dict[str, str]:
    """Return labels by name: of shipped policies, then of runs, newest first."""
    shipped = sorted(folder.parent for folder in loading.SHIPPED.glob("*/checkpoints"))
    folders = {folder.name: folder for folder in shipped}
    folders |= {str(run): run for run in newest_runs(RUNS)}
    return {name: name + _reason(folder) for name, folder in folders.items()}


def _reason(run: Path) -> str:
    """Return why a run cannot be shown, if so."""
    task = task_of(run)
    if task.startswith(GYMNASIUM):
        return " (no MuJoCo robot)"
    return " (needs mjlab)" if task.startswith(MJLAB) and find_spec("mjlab") is None else ""


class Choice(NamedTuple):
    """A checkpoint to show, and the other checkpoints of its run."""

    run: str  # a folder, a shipped name, or a checkpoint file outside any run
    checkpoint: str  # its name: "best"
    files: dict[str, Path]  # the checkpoints of the run by name

    @property
    def file(self) -> Path:
        return self.files[self.checkpoint]

    def written(self) -> list[int]:
        """Return when each file that training writes, and the page shows, was written; 0: never."""
        run = folder_of(self.file)
        files = self.file, front_path(self.file), run / "metrics.csv", run / FRONTS
        return [file.stat().st_mtime_ns if file.exists() else 0 for file in files]

    @property
    def argument(self) -> str:
        """What names the checkpoint in a command line: its run, or the file."""
        return self.run if loading.find_checkpoint(self.run) == self.file else str(self.file)

    @property
    def folder(self) -> Path:
        """The folder to write files into: the run's, or the working directory if it is shipped."""
        return loading.own_folder(self.file) or Path()

    def export(self, tradeoff: Sequence[float], body: Policy | None = None) -> list[Path]:
        """Write a trade-off's policy as ONNX, of another `body` if any; return the files."""
        run = self._saved(body)
        # another process, because torch.export replaces functions that the robots' networks run
        ignore = signal.signal, (signal.SIGINT, signal.SIG_IGN)
        with ProcessPoolExecutor(1, get_context("spawn"), *ignore) as pool:
            arguments = named_task(self.folder), run, self.folder / POLICY, tradeoff
            return pool.submit(_export, *arguments).result()

    def write_card(self, policy: Policy, choice: Chosen, body: Policy | None = None) -> list[Path]:
        """Write the decision card of a trade-off, see `export`; return the file."""
        from ...reports.page import card  # takes a while to import
        from ..filming.recording import strip

        source = self._saved(body)
        run = shlex.quote(source) + (" --trust" if runs_code(policy.config.env) else "")
        export = f"morlax export {run} --tradeoff {shown(choice.tradeoff)}"
        commands = [export, f"morlax explore {run}"]
        write_file(self.folder / CARD, card(source, policy, choice, commands, strip))
        return [self.folder / CARD]

    def _saved(self, body: Policy | None) -> str:
        """Return the name of this checkpoint for commands, or save a `body` and return its file."""
        if body is None:
            return self.argument
        loading.save(body, self.folder / BODY)
        return str(self.folder / BODY)


def choose(run: str, checkpoint: str | None = None) -> Choice:
    """Find a checkpoint of a run, or raise MorlaxError.

    `checkpoint` is its name, such as "latest" (None: the best one, the latest of a run that is
    being trained, or the checkpoint file `run`).
    """
    run = str(loading.named_run(run))
    file = loading.find_checkpoint(run)
    if Path(run).is_file():
        if file.parent.name != "checkpoints":
            return Choice(run, file.stem, {file.stem: file})
        run = str(loading.find_run(run))
    elif is_training(folder_of(file)):
        file = file.with_stem("latest")
    files = {file.stem: file for file in sorted(file.parent.glob("*.pt"))}
    name = checkpoint or file.stem
    if name not in files:
        raise unknown("checkpoint", name, files)
    return Choice(run, name, files)


def _export(task: str | None, run: str, output: Path, tradeoff: Sequence[float]) -> list[Path]:
    """Write a policy as `morlax export` does; `task` is a moved FILE.py:CLASS."""
    from ...exports.deployment import SETTINGS, deploy  # takes a while to import
    from ...exports.exporting import export, provenance

    policy = loading.load(run, trust=True, env=task)  # its robots move already
    robot, origin = policy.make_robot(), {"run": provenance(run)}
    export(policy, output, "onnx", tradeoff, origin, robot)
    lacks = deploy(robot, output, policy.config.env, policy.objectives, tradeoff)
    return [output] if lacks is None else [output, output.with_name(SETTINGS)]
