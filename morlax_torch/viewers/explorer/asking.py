"""Ask "A or B?" until a source has no more questions, wherever its behaviors come from."""

from typing import Any

from .comparisons import Comparisons, Question
from .session import Behavior


class Asking:
    """The state of questions and answers.

    `behaviors` are A and B, which may be others after each answer, and none at the end.

    Args:
        source: of questions.
    """

    def __init__(self, source: Comparisons):
        self._source, self.answers = source, 0
        self._question: Question | None = None
        self._told: dict[str, Any] | None = None  # the answer before
        self._ask()

    @property
    def behaviors(self) -> tuple[Behavior, ...]:
        return self._question.behaviors if self._question else ()

    def answer(self, preferred: int) -> None:
        """Learn that the user prefers A (0) or B (1), and ask the next question."""
        if self._question is None:
            return
        self._told = {"preferred": preferred, "policies": self._question.policies}
        self._source.answer(preferred)
        self.answers += 1
        self._ask()

    def skip(self) -> None:
        """Ask another question."""
        if self._question is not None:
            self._told = None
            self._ask()

    def state(self) -> dict[str, Any]:
        """Describe the question for a page."""
        return {"answers": self.answers, "over": self._question is None, "told": self._told}

    def _ask(self) -> None:
        self._question = self._source.ask()
