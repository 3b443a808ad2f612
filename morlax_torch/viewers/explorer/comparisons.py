"""Questions "A or B?" to a user: which two behaviors to compare next, and who learns from it."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple, Protocol

import mujoco
from numpy.typing import ArrayLike

from ... import envs
from ...evaluation.front import Front
from ..preferences.teaching import Lesson
from ..preferences.tradeoff import Preference
from .session import Behavior, Clip, Session, Weights


class Question(NamedTuple):
    """Two behaviors, A and B."""

    behaviors: tuple[Behavior, Behavior]
    policies: tuple[int, int] | None = None  # their indices on a front


class Comparisons(Protocol):
    """A source of questions. `ComparisonExhibit` puts them to a user."""

    def ask(self) -> Question | None:
        """Return the next question; None after the last one."""
        ...

    def answer(self, preferred: int) -> None:
        """Learn that the user prefers behavior 0 (A) or 1 (B) of the last question."""
        ...


class PolicyComparisons:
    """Compare policies of a front with two robots to find the one that the user likes best."""

    def __init__(self, front: Front, sessions: tuple[Session, Session], seed: int = 0):
        self._preference = Preference(front, seed)
        self._front, self._sessions = front, sessions

    def ask(self) -> Question:
        preference = self._preference
        self._pair = preference.pair()  # of the front
        index, tradeoff = self.best()
        self.evidence = {  # of the answers, for a page; policies are indices on the front
            "best": index,
            "best_tradeoff": tradeoff,
            "possible": preference.possible().tolist(),
            "confidence": preference.confidence(),
            "left": preference.questions_left(),
        }
        for session, policy in zip(self._sessions, self._pair, strict=True):
            session.tradeoff = tuple(self._front.tradeoffs[policy].tolist())
            session.reset()
        return Question(self._sessions, self._pair)

    def answer(self, preferred: int) -> None:
        self._preference.answer(self._pair[preferred], self._pair[1 - preferred])

    def best(self) -> tuple[int, Weights]:
        """Return the index on the front of the policy liked best so far, and its trade-off."""
        index = self._preference.best()
        return index, tuple(self._front.tradeoffs[index].tolist())


class ClipComparisons:
    """Compare recorded motions of one robot, two at a time.

    Args:
        model: the robot.
        dt: seconds between two positions of a clip.
        pairs: positions (T, nq) of A and of B for each question; may be endless.
        answered: called with the number of the question, from 0, and with the preferred clip,
            0 (A) or 1 (B). It is not called for skipped questions.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        dt: float,
        pairs: Iterable[Sequence[ArrayLike]],
        answered: Callable[[int, int], None],
    ):
        self._model, self._dt = model, dt
        self._pairs, self._answered = enumerate(pairs), answered

    def ask(self) -> Question | None:
        self._number, pair = next(self._pairs, (None, None))
        if pair is None:
            return None
        a, b = (Clip(self._model, qpos, self._dt) for qpos in pair)
        return Question((a, b))

    def answer(self, preferred: int) -> None:
        assert self._number is not None, "nothing was asked"
        self._answered(self._number, preferred)


def questions(lesson: Lesson, most: int) -> ClipComparisons:
    """Ask about `most` pairs of a lesson's clips, and save each answer."""
    config, comparisons = lesson.policy.config, lesson.comparisons
    robot = envs.make_robot(config.env, **config.task.for_evaluation().model_dump())
    pair = 0, 0

    def pairs() -> Iterator[list[ArrayLike]]:
        nonlocal pair
        for _ in range(most):
            pair = comparisons.pair(lesson.random)
            yield [comparisons.clips.qpos[clip] for clip in pair]

    def answered(_: int, preferred: int) -> None:
        comparisons.answers.append((pair[preferred], pair[1 - preferred]))
        lesson.save()

    return ClipComparisons(robot.physics.model, robot.dt, pairs(), answered)
