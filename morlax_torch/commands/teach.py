"""Teach an objective that nobody can write down, by comparisons of clips."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pydantic import NonNegativeInt

from .terminal import cli
from .terminal.arguments import OfRun, Positional, Served, arg, parse
from .terminal.process import typed


class Teach(OfRun, Served):
    """Learn a reward from comparisons of a MuJoCo robot's clips, and write a config with it."""

    folder: Annotated[Path, Positional, arg(metavar="FOLDER")]
    """Folder of the comparisons; an earlier one continues with its answers."""
    objective: Annotated[str, arg(metavar="NAME")]
    """Name of the new objective."""
    answers: NonNegativeInt = 300
    """Number of questions to ask at most; Ctrl-C ends earlier, 0 asks none."""
    judge: Annotated[str | None, arg(metavar="TERM")] = None
    """Reward term of the task whose sum answers in place of a user, to try this out."""
    clips: int = 200
    """Number of clips to record of a run."""
    seed: int = 0
    """Random seed."""


def command(arguments: Sequence[str]) -> None:
    options = parse(Teach, arguments)
    answers = options.answers
    with cli.Live():
        from ..runs.loading import trust_run
        from ..viewers.preferences.teaching import Lesson

        trust_run(options.run, options.trust, options.env)
        lesson = Lesson(options.run, options.folder, options.objective, options.clips, options.seed)
    if options.judge is not None:
        lesson.comparisons.judge(options.judge, answers, lesson.random)
    elif answers:
        from ..viewers.explorer.comparisons import lesson_questions
        from ..viewers.explorer.exhibits import ComparisonExhibit

        options.serve(
            lambda _: ComparisonExhibit(lesson_questions(lesson, answers)), "when you have answered"
        )
    with cli.Live():
        fitted = lesson.finish()
    cli.console.print(
        f"{len(lesson.comparisons.answers)} answers; the learned reward agrees with "
        f"{fitted.accuracy:.0%} of {fitted.checked} that it was not fitted to"
    )
    cli.print_command("train", typed("train", "--config", options.folder / "config.yaml"))
