"""Teach an objective that nobody can write down, by comparisons of clips."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from .envs.lazy import handed_on
from .terminal import cli
from .terminal.startup import program

if TYPE_CHECKING:
    from .preferences.teaching import Lesson as Lesson

__getattr__, __dir__ = handed_on(__name__, {"Lesson": "preferences.teaching"})


def command(arguments: Sequence[str]) -> None:
    def main(
        run: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")],
        folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")],
        objective: Annotated[str, tyro.conf.arg(metavar="NAME")],
        judge: Annotated[str, tyro.conf.arg(metavar="TERM")],
        answers: int = 300,
        clips: int = 200,
        seed: int = 0,
        trust: bool = False,
    ) -> None:
        """Learn a reward from comparisons of a run's clips, and write a config to train with it.

        Args:
            run: Run folder, checkpoint file, or shipped policy, of a MuJoCo robot.
            folder: Folder of the comparisons; an earlier one continues with its answers.
            objective: Name of the new objective.
            judge: Reward term of the task whose sum answers in place of a user, to try this out.
            answers: Number of answers of the judge.
            clips: Number of clips to record of a run.
            seed: Random seed.
            trust: Let the run import the FILE.py or module that its task names.
        """
        from .preferences.teaching import Lesson
        from .runs.loading import trust_task

        if trust:
            trust_task(run)
        lesson = Lesson(run, folder, objective, clips, seed)
        lesson.judge(judge, answers)
        fitted = lesson.finish()
        cli.console.print(
            f"{len(lesson.comparisons)} answers; the learned reward agrees with "
            f"{fitted.accuracy:.0%} of {fitted.checked} that it was not fitted to"
        )
        config = shlex.quote(str(folder / "config.yaml"))
        cli.console.print(f"train: {program('train')} --config {config}", markup=False)

    tyro.cli(main, args=arguments, prog=program("teach"))


def main() -> None:
    cli.run(command)


if __name__ == "__main__":
    main()
