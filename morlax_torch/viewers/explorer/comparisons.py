"""Ask "A or B?" about two policies at a time, to find the one that a user likes best."""

from typing import Any

from ...evaluation.front import Front
from .preference import Preference
from .session import Session, Weights


class Comparison:
    """Shows two policies of a front with two robots; the next two follow each answer.

    Raises MorlaxError if there are no two policies to compare.
    """

    def __init__(self, front: Front, robots: tuple[Session, Session], seed: int = 0):
        self.robots = robots
        self._front, self._preference = front, Preference(front, seed)
        self._answers = 0
        self._told: dict[str, Any] | None = None  # the answer before
        self._ask()

    @property
    def best_tradeoff(self) -> Weights:
        """The trade-off that the user seems to like best."""
        return tuple(self._front.tradeoffs[self._preference.best()].tolist())

    def _ask(self) -> None:
        """Show other policies, each from the start of an episode."""
        self._pair = self._preference.pair()
        for session, policy in zip(self.robots, self._pair, strict=True):
            session.tradeoff = tuple(self._front.tradeoffs[policy].tolist())
            session.reset(self._answers)
        self._evidence = {
            "best_tradeoff": self.best_tradeoff,
            "possible": self._preference.possible().tolist(),  # indices on the front
            "confidence": self._preference.confidence(),
            "left": self._preference.questions_left(),
        }

    def state(self) -> dict[str, Any]:
        """Describe the answers so far, and their evidence, for a page."""
        return {"answers": self._answers, "told": self._told, **self._evidence}

    def answer(self, preferred: int) -> None:
        """Learn that the user prefers A (0) or B (1)."""
        self._told = {"preferred": preferred, "policies": self._pair}
        self._preference.answer(self._pair[preferred], self._pair[1 - preferred])
        self._answers += 1
        self._ask()

    def skip(self) -> None:
        self._told = None
        self._ask()
