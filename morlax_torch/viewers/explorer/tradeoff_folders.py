"""The folders that set a trade-off: by weights, and by what its policy must reach."""

from collections.abc import Callable

import viser

from .session import Session
from .steering import Put, Steering
from .thresholds import Thresholds
from .weights import Weights


class TradeoffFolders:
    """The folders "objective weights" and, with a front, "at least".

    Args:
        gui: viser's widgets.
        session: whose objectives and front they are.
        put: queues a request of a browser.
        steer: called with the trade-off that a user has set, or that reaches the thresholds.
    """

    def __init__(
        self, gui: viser.GuiApi, session: Session, put: Put, steer: Callable[[Weights], None]
    ):
        self._steer = steer
        self._weights = gui.add_folder("objective weights", order=2)
        with self._weights:
            self._steering = Steering(gui, session, put, steer)
        self._at_least = gui.add_folder(
            "at least", order=2.5, expand_by_default=False, visible=session.front is not None
        )
        self._thresholds = None
        if session.front is not None:
            with self._at_least:
                self._thresholds = Thresholds(
                    gui, session.player.policy, session.front, put, self.jump
                )

    @property
    def levels(self) -> dict[int, float]:
        """A copy of the required returns, by index of the objective."""
        return dict(self._thresholds.levels) if self._thresholds else {}

    def show(self, tradeoff: Weights, field: bool = True) -> None:
        """Show a trade-off; in the text field only if `field`, which may be in use."""
        self._steering.show(tradeoff, field)

    def jump(self, tradeoff: Weights) -> None:
        """Steer to a trade-off that does not come from the sliders."""
        self._steer(tradeoff)
        self._steering.show(tradeoff)

    def reveal(self, visible: bool) -> None:
        """Show or hide the folders; without a front there are no thresholds to show."""
        self._weights.visible = visible
        self._at_least.visible = visible and self._thresholds is not None

    def remove(self) -> None:
        """Remove the folders from the page."""
        if self._thresholds is not None:
            self._thresholds.stop()
        self._weights.remove()
        self._at_least.remove()
