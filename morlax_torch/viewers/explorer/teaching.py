"""The clips of a lesson, as questions of the page "A or B?"."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ... import envs
from ...preferences.teaching import Lesson
from .comparisons import ClipComparisons


def questions(lesson: Lesson, most: int) -> ClipComparisons:
    """Ask about pairs of a lesson's clips, and save each answer.

    Args:
        lesson: whose clips to compare.
        most: number of questions.
    """
    config = lesson.policy.config
    robot = envs.make_robot(config.env, **config.task.for_evaluation().model_dump())
    asked: list[tuple[int, int]] = []

    def pairs() -> Iterator[tuple[NDArray[np.float32], NDArray[np.float32]]]:
        for _ in range(most):
            asked.append(lesson.pair())
            first, second = asked[-1]
            yield lesson.comparisons.clips.qpos[first], lesson.comparisons.clips.qpos[second]

    def answered(number: int, preferred: int) -> None:
        pair = asked[number]
        lesson.comparisons.answer(pair[preferred], pair[1 - preferred])
        lesson.save()

    return ClipComparisons(robot.physics.model, robot.dt, pairs(), answered)
