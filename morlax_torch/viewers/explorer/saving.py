"""Write files from the page by this package's own commands, while the robots go on."""

import subprocess
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...evaluation.requirements import shown
from ...networks.policy import Policy
from ...runs.loading import find_checkpoint, own_folder, save
from ...runs.references import named_task
from .library import Choice
from .requests import Put
from .session import Weights

CARD = "decision.html"
BODY = "body.pt"  # policies of a body that is not the checkpoint's


class Saving:
    """Runs one command at a time, in a process of its own.

    Files lie where the commands write them: in the run's folder, or in the working directory for a
    shipped policy.

    Args:
        choice: the checkpoint whose policies are written.
        put: queues a request.
    """

    def __init__(self, choice: Choice, put: Put):
        self._put = put
        self._run = choice.run
        if find_checkpoint(choice.run) != choice.file:
            self._run = str(choice.file)
        self._folder = own_folder(choice.file) or Path()
        self._busy, self._text = False, ""

    def state(self) -> dict[str, Any]:
        """Describe for a page what is written, or how it ended."""
        return {"busy": self._busy, "text": self._text}

    def export(self, tradeoff: Weights, body: Policy | None = None) -> None:
        """Write a trade-off's policy, as `morlax export` does; first, that of another body."""
        run = self._run
        if body is not None:
            run = str(self._folder / BODY)
            save(body, run)
        self._start("Exporting the policy…", run, "export", "--tradeoff", shown(tradeoff))

    def card(self, required: Sequence[str]) -> None:
        """Write a decision card, given options of `morlax choose` that say what is required."""
        doing = "Trying the policy under other conditions…"
        self._start(doing, self._run, "choose", *required, "--card", str(self._folder / CARD))

    def _start(self, doing: str, run: str, command: str, *arguments: str) -> None:
        if self._busy:
            return
        self._busy, self._text = True, doing
        # the checkpoint's code, if it names any, runs in this process already
        words = [sys.executable, "-m", "morlax_torch", command, run, *arguments, "--trust"]
        if moved := named_task(self._folder):
            words += ["--env", moved]
        threading.Thread(target=self._execute, args=[words], daemon=True).start()

    def _execute(self, words: list[str]) -> None:
        done = subprocess.run(words, stdin=subprocess.DEVNULL, capture_output=True, text=True)
        lines = done.stdout.splitlines()
        told = [line for line in lines if line.startswith("written:")]
        error = done.stderr.rpartition("error: ")[2]  # progress may precede it
        text = " ".join((error if done.returncode else "\n".join(told)).split())
        self._put(lambda: self._end(text))

    def _end(self, text: str) -> None:
        self._busy, self._text = False, text
