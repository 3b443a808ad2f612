"""Write files from the page, in a process of its own, while the robots go on."""

import shlex
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from ...envs import MorlaxError, resolve_device
from ...envs.making import has_robot
from ...envs.naming import runs_code, title
from ...evaluation.requirements import Choice as Chosen
from ...evaluation.requirements import shown
from ...host.files import write_file
from ...host.version import __version__
from ...networks.policy import Policy
from ...runs.checkpoint import fingerprint
from ...runs.loading import find_checkpoint, load, own_folder, save
from ...runs.references import named_task
from .library import Choice
from .session import Put, Weights

POLICY, CARD = "policy.onnx", "decision.html"
BODY = "body.pt"  # policies of a body that is not the checkpoint's


class Saving:
    """Writes files of a checkpoint into its run's folder, or the working directory if shipped."""

    def __init__(self, choice: Choice, put: Put):
        self._put = put
        best = find_checkpoint(choice.run) == choice.file
        self._run = choice.run if best else str(choice.file)
        self._folder = own_folder(choice.file) or Path()
        self._busy, self._text = False, ""

    def state(self) -> dict[str, Any]:
        """Describe the work for a page."""
        return {"busy": self._busy, "text": self._text}

    def export(self, tradeoff: Weights, body: Policy | None = None) -> None:
        """Write a trade-off's policy as ONNX; first, the policies of a body without checkpoint."""
        run = self._run
        if body is not None:
            run = str(self._folder / BODY)
            save(body, run)
        self._start("Exporting the policy…", write_policy, run, self._folder / POLICY, tradeoff)

    def card(self, choice: Chosen) -> None:
        doing, file = "Trying the policy under other conditions…", self._folder / CARD
        self._start(doing, write_card, self._run, file, choice)

    def _start(self, doing: str, write: Callable[..., list[Path]], *arguments: Any) -> None:
        if self._busy:
            return
        self._busy, self._text = True, doing
        # a process, because torch.export replaces functions that the robots' networks run through
        ignore = signal.signal, (signal.SIGINT, signal.SIG_IGN)
        pool = ProcessPoolExecutor(1, get_context("spawn"), *ignore)
        future = pool.submit(write, named_task(self._folder), *arguments)
        future.add_done_callback(lambda done: self._put(partial(self._end, done)))
        pool.shutdown(wait=False)

    def _end(self, done: Future[list[Path]]) -> None:
        error = done.exception()
        self._busy, self._text = False, str(error or "written: ")
        if error is None:
            self._text += ", ".join(map(str, done.result()))
        elif not isinstance(error, MorlaxError):
            raise error


def write_policy(task: str | None, run: str, output: Path, tradeoff: Weights) -> list[Path]:
    """Write a policy as `morlax export` does; `task` is a moved FILE.py:CLASS. Return the files."""
    from ...exports.deployment import SETTINGS, deploy  # takes a while to import
    from ...exports.exporting import export, provenance, robot_of

    policy = load(run, trust=True, env=task)  # its robots move already
    robot, about = robot_of(policy), {"run": provenance(run)}
    export(policy, output, "onnx", tradeoff, about, robot)
    lacks = deploy(robot, output, policy.config.env, policy.objectives, tradeoff)
    return [output] if lacks is None else [output, output.with_name(SETTINGS)]


def write_card(task: str | None, run: str, output: Path, choice: Chosen) -> list[Path]:
    """Write the card of a choice as `morlax choose --card` does; return the file."""
    policy = load(run, resolve_device(None), trust=True, env=task)
    quoted = shlex.quote(run) + (" --trust" if runs_code(policy.config.env) else "")
    export = f"morlax export {quoted} --tradeoff {shown(choice.tradeoff)}"
    commands = [export, f"morlax explore {quoted}"]
    write_file(output, decision_card(run, policy, choice, commands))
    return [output]


def decision_card(
    run: str, policy: Policy, choice: Chosen, commands: Sequence[str], seed: int = 0
) -> str:
    """Simulate a choice under other conditions, and describe it; returns HTML.

    `commands` are command lines that use it. The policy ends on the CPU.
    """
    from ...reports.page import card  # takes a while to import
    from ...runs.choosing import trials
    from ..filming.recording import strip

    tried, env = trials(policy, choice.tradeoff, seed), policy.config.env
    facts = {
        "run": run,
        "checkpoint": str(find_checkpoint(run)),
        "fingerprint of the policies": fingerprint(policy.agent.state_dict()),
        "morlax-torch": __version__,
    }
    picture = strip(policy.cpu(), choice.tradeoff) if has_robot(env) else None
    return card(title(env), choice, tried, facts, commands, picture)
