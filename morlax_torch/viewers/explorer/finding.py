"""The mode "A or B?": find a user's trade-off by comparing policies of the front."""

from collections.abc import Callable
from html import escape
from typing import Any

import viser

from ...envs import MorlaxError
from .asking import Asking
from .behavior import Behavior
from .comparisons import PolicyComparisons
from .session import Session
from .status import NO_FRONT, small
from .steering import Put
from .weights import Weights, show

USE, AGAIN, LEAVE = "use this trade-off", "start again", "back"


class Finding:
    """The folder of the mode, with two robots of its own.

    Args:
        gui: viser's widgets; the folder is added to the current container.
        session: whose policies are compared.
        put: queues a request of a browser.
        leave: called at the end with the trade-off to use, or with None.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        session: Session,
        put: Put,
        leave: Callable[[Weights | None], None],
    ):
        self._put, self._leave, self._front = put, leave, session.front
        self._asking: Asking | None = None
        self._rounds = self._told = 0
        self._folder = gui.add_folder("A or B?", order=2)
        with self._folder:
            self._offer(gui, session)

    @property
    def behaviors(self) -> tuple[Behavior, ...]:
        """A and B; nothing if there is nothing to compare."""
        return self._asking.behaviors if self._asking else ()

    def remove(self) -> None:
        """Remove the folder from the page."""
        self._folder.remove()

    def _offer(self, gui: viser.GuiApi, session: Session) -> None:
        """Add the question, or one sentence that says why nothing can be compared."""
        options: tuple[str, ...] = (LEAVE,)
        if self._front is None:
            gui.add_html(NO_FRONT)
        else:
            self._robots = (session.twin(), session.twin())
            try:
                self._source = PolicyComparisons(self._front, self._robots)
            except MorlaxError as error:
                text = str(error)
                gui.add_html(small(escape(text[:1].upper() + text[1:])))
            else:
                names = self._front.objectives
                self._asking = Asking(gui, self._source, self._put, names, self._tell)
                self._best = gui.add_html("")
                options = (USE, AGAIN, LEAVE)
        self._buttons = gui.add_button_group("", options)
        self._buttons.on_click(self._clicked)

    async def _clicked(self, event: viser.GuiEvent[Any]) -> None:
        pressed = event.target.value
        self._put(lambda: self._react(pressed))

    def _react(self, pressed: str) -> None:
        if pressed == LEAVE:
            self._leave(None)
        elif self._asking is None or self._front is None:
            return
        elif pressed == USE:
            self._leave(self._source.best()[1])
        elif pressed == AGAIN:
            self._rounds += 1
            self._source = PolicyComparisons(self._front, self._robots, seed=self._rounds)
            self._best.content = ""
            self._asking.begin(self._source)

    def _tell(self) -> None:
        """Show the policy that the user likes best so far."""
        if self._front is None:
            return
        index, tradeoff = self._source.best()
        names = [escape(name) for name in self._front.objectives]
        weights = ", ".join(f"{n} {w:.2f}" for n, w in zip(names, tradeoff, strict=True))
        returns = zip(names, self._front.returns[index], strict=True)
        sums = ", ".join(f"{name} {value:,.0f}" for name, value in returns)
        self._best.content = small(
            f'<span data-best="{show(tradeoff)}"><b>You seem to like</b> policy {index}: {weights}'
            f"</span><br>Its returns: {sums}"
        )
