"""Teach an objective that nobody can write down, by comparisons of clips."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from ..envs import MorlaxError
from ..viewers.explorer.opening import free_port, importing_page
from .terminal import cli
from .terminal.interrupt import interruptible
from .terminal.live import Live
from .terminal.startup import program
from .terminal.task_arguments import (
    Host,
    Moved,
    Port,
    Trust,
    call,
)

if TYPE_CHECKING:
    from ..viewers.preferences.teaching import Lesson


def command(arguments: Sequence[str]) -> None:
    def main(
        run: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")],
        folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")],
        objective: Annotated[str, tyro.conf.arg(metavar="NAME")],
        answers: int = 300,
        judge: Annotated[str | None, tyro.conf.arg(metavar="TERM")] = None,
        clips: int = 200,
        seed: int = 0,
        host: Host = "127.0.0.1",
        port: Port = 8080,
        trust: Trust = False,
        env: Moved = None,
    ) -> None:
        """Learn a reward from comparisons of a run's clips, and write a config to train with it.

        Args:
            run: Run folder (runs/TASK or latest: the newest run), checkpoint file, or shipped
                policy, of a MuJoCo robot.
            folder: Folder of the comparisons; an earlier one continues with its answers.
            objective: Name of the new objective.
            answers: Number of questions to ask at most; Ctrl-C ends earlier, 0 asks none.
            judge: Reward term of the task whose sum answers in place of a user, to try this out.
            clips: Number of clips to record of a run.
            seed: Random seed.
        """
        serves = judge is None and answers > 0
        with Live():
            from ..runs.loading import trust_run
            from ..viewers.preferences.teaching import Lesson

            trust_run(run, trust, env)
            if serves:
                port = free_port(host, port)
            lesson = Lesson(run, folder, objective, clips, seed)
        if answers < 0:
            raise MorlaxError(f"there are {answers} answers to give: name 0 or more.")
        if judge is not None:
            lesson.judge(judge, answers)
        elif serves:
            _ask(lesson, answers, host, port)
        with Live():
            fitted = lesson.finish()
        cli.console.print(
            f"{len(lesson.comparisons)} answers; the learned reward agrees with "
            f"{fitted.accuracy:.0%} of {fitted.checked} that it was not fitted to"
        )
        config = shlex.quote(str(folder / "config.yaml"))
        cli.print_command("train", f"{program('train')} --config {config}")

    call(main, arguments, program("teach"))


def _ask(lesson: "Lesson", answers: int, host: str, port: int) -> None:
    """Serve a page that asks a user, until Ctrl-C."""
    with importing_page():
        from ..viewers.explorer.comparisons import questions
        from ..viewers.explorer.exhibits import ComparisonExhibit
        from ..viewers.explorer.page import Page

    with interruptible() as ended:
        page = Page(lambda _: ComparisonExhibit(questions(lesson, answers)), host, port)
        cli.console.print(f"open {page.address}  (Ctrl-C when you have answered)")
        page.serve(ended)
        page.stop()
