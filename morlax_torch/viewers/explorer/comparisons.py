"""Questions "A or B?" to a user: which two behaviors to compare next, and who learns from it."""

from collections.abc import Callable, Generator, Iterable, Sequence
from typing import Any

import mujoco
from numpy.typing import ArrayLike

from ...evaluation.front import Front
from ..preferences.teaching import Lesson
from ..preferences.tradeoff import Preference
from .session import Behavior, Clip, Session

# yields the behaviors A and B, and evidence of the answers so far for a page; is sent the preferred
# behavior, 0 (A) or 1 (B), or None for a skipped question
Questions = Generator[tuple[Sequence[Behavior], dict[str, Any]], int | None, None]


def policy_questions(front: Front, sessions: tuple[Session, Session], seed: int = 0) -> Questions:
    """Compare policies of a front with two robots to find the one that the user likes best."""
    preference = Preference(front, seed)
    while True:
        pair, best = preference.pair(), preference.best()
        evidence = {  # policies are indices on the front
            "policies": pair,
            "best": best,
            "best_tradeoff": tuple(front.tradeoffs[best].tolist()),
            "possible": preference.possible().tolist(),
            "confidence": preference.confidence(),
            "left": preference.questions_left(),
        }
        for session, policy in zip(sessions, pair, strict=True):
            session.tradeoff = tuple(front.tradeoffs[policy].tolist())
            session.reset()
        preferred = yield sessions, evidence
        if preferred is not None:
            preference.answer(pair[preferred], pair[1 - preferred])


def clip_questions(
    model: mujoco.MjModel,
    dt: float,
    pairs: Iterable[Sequence[ArrayLike]],
    answered: Callable[[int, int], None],
) -> Questions:
    """Compare recorded motions of one robot, two at a time.

    Args:
        model: the robot.
        dt: seconds between two positions of a clip.
        pairs: positions (T, nq) of A and of B for each question; may be endless.
        answered: called with the number of the question, from 0, and with the preferred clip,
            0 (A) or 1 (B). It is not called for skipped questions.
    """
    for number, pair in enumerate(pairs):
        preferred = yield [Clip(model, qpos, dt) for qpos in pair], {}
        if preferred is not None:
            answered(number, preferred)


def lesson_questions(lesson: Lesson, most: int) -> Questions:
    """Ask about `most` pairs of a lesson's clips, and save each answer."""
    robot, comparisons = lesson.policy.make_robot(), lesson.comparisons
    for _ in range(most):
        pair = comparisons.pair(lesson.random)
        positions = [comparisons.clips.qpos[clip] for clip in pair]
        preferred = yield [Clip(robot.physics.model, qpos, robot.dt) for qpos in positions], {}
        if preferred is not None:
            comparisons.answers.append((pair[preferred], pair[1 - preferred]))
            lesson.save()
