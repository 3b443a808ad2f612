"""The widgets that ask which of two behaviors a user prefers."""

from collections.abc import Callable
from html import escape
from typing import Any

import viser

from .behavior import Behavior
from .comparisons import Comparisons
from .status import small
from .steering import Put
from .weights import Weights, show

NAMES = ("A", "B")
SKIP = "skip"
NONE_LEFT = "There is nothing left to compare."


class Asking:
    """Ask "A or B?" until a source has no more questions, wherever its behaviors come from.

    Whoever made this shows `behaviors` next to each other, named `NAMES`; they may be others after
    each answer.

    Args:
        gui: viser's widgets; these are added to the current container.
        source: of questions.
        put: queues a request of a browser.
        objectives: names of the weights of trade-offs, to show those of A and B.
        answered: called after each answer.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        source: Comparisons,
        put: Put,
        objectives: tuple[str, ...] = (),
        answered: Callable[[], None] = lambda: None,
    ):
        self._put, self._objectives, self._answered = put, objectives, answered
        self._text = gui.add_html("")
        hint = "Skip if you cannot tell."
        self._buttons = gui.add_button_group("I prefer", (*NAMES, SKIP), hint=hint)
        self._buttons.on_click(self._clicked)
        self.begin(source)

    def begin(self, source: Comparisons) -> None:
        """Ask the first question of a source."""
        self._source, self.answers = source, 0
        self.behaviors: tuple[Behavior, ...] = ()  # A and B; nothing when no question is left
        self._ask()

    async def _clicked(self, event: viser.GuiEvent[Any]) -> None:
        pressed = event.target.value
        self._put(lambda: self._react(pressed))

    def _react(self, pressed: str) -> None:
        if not self.behaviors:
            return
        if pressed in NAMES:
            self._source.answer(NAMES.index(pressed))
            self.answers += 1
            self._answered()
        self._ask()

    def _ask(self) -> None:
        question = self._source.ask()
        self._buttons.visible = question is not None
        if question is None:
            self.behaviors, lines = (), [NONE_LEFT]
        else:
            self.behaviors, lines = question.behaviors, ["Which robot do you like better?"]
            tradeoffs = zip(NAMES, question.tradeoffs or (), strict=False)
            lines += [self._line(name, weights) for name, weights in tradeoffs]
        number = f'<span data-answers="{self.answers}">Answers so far: {self.answers}</span>'
        self._text.content = small("<br>".join([*lines, number]))

    def _line(self, name: str, weights: Weights) -> str:
        parts = zip(self._objectives, weights, strict=True)
        told = ", ".join(f"{escape(objective)} {weight:.2f}" for objective, weight in parts)
        return f'<b>{name}</b>: <span data-{name.lower()}="{show(weights)}">{told}</span>'
