"""The panel that shows the front, and how its plot relates to the robots."""

from collections.abc import Sequence
from html import escape
from typing import Any

import viser

from .drawing import Drawing
from .session import Session
from .status import NO_FRONT, small
from .steering import Put


class FrontView:
    """The drawing of the front, in the current GUI container.

    Three and more objectives have a choice of those on the axes.

    Args:
        gui: viser's widgets.
        session: whose front is shown.
        put: queues a request of a browser.
    """

    def __init__(self, gui: viser.GuiApi, session: Session, put: Put):
        self._session, self._put = session, put
        self._parts: list[Any] = []
        self._axes: list[viser.GuiDropdownHandle[str]] = []
        names = session.objectives
        if session.front is None:
            self._parts.append(gui.add_html(NO_FRONT))
        elif len(names) > 2:
            for label, name in zip(("x axis", "y axis"), names, strict=False):
                axis = gui.add_dropdown(label, names, initial_value=name)
                axis.on_update(self._chosen)
                self._axes.append(axis)
        if session.front is not None and session.front.checkpoint:
            self._parts.append(gui.add_html(small(f"front of {escape(session.front.checkpoint)}")))
        self.drawing = Drawing(names, session.front, (0, 1))
        self._html = gui.add_html(self.drawing.html())
        self._marks = gui.add_html("")

    def mark(self, sessions: Sequence[Session], selected: int, levels: dict[int, float]) -> None:
        """Mark the trade-offs of robots, and required returns."""
        nearest = [session.nearest() for session in sessions]
        others = [i for k, i in enumerate(nearest) if k != selected and i is not None]
        session = sessions[selected]
        marks = self.drawing.marks(session.tradeoff, nearest[selected], others, levels)
        self._marks.content = marks

    def remove(self) -> None:
        """Remove the drawing from the page."""
        for part in (*self._parts, *self._axes, self._html, self._marks):
            part.remove()

    async def _chosen(self, event: viser.GuiEvent[Any]) -> None:
        if event.client is not None:
            self._put(self._redraw)

    def _redraw(self) -> None:
        names = self._session.objectives
        x, y = (names.index(axis.value) for axis in self._axes)
        self.drawing = Drawing(names, self._session.front, (x, y))
        self._html.content = self.drawing.html()
