"""The robots of one run and the widgets that depend on it."""

from collections.abc import Sequence

import viser

from ...envs.naming import title
from .asking import NAMES
from .behavior import Behavior
from .charts import Charts
from .commands import Commands
from .controls import ADD, DROP, FIND, RESET, SHOVE, Controls
from .finding import Finding
from .front_view import FrontView
from .lineup import Lineup
from .session import Session
from .status import status
from .steering import Put
from .tradeoff_folders import TradeoffFolders
from .weights import Weights


class RunPanel:
    """Everything of a run except its drawing in 3D: the page shows `behaviors` on its stage.

    Args:
        server: viser's server.
        session: the run's first robot.
        put: queues a request of a browser.
        controls: the widgets that every run shares.
    """

    def __init__(self, server: viser.ViserServer, session: Session, put: Put, controls: Controls):
        self._gui, self._put, self._controls = server.gui, put, controls
        self._gui.set_panel_label(title(session.player.policy.config.env))
        self._lineup = Lineup(session)
        self._finding: Finding | None = None
        self._marked: object = None
        self._folders = TradeoffFolders(self._gui, session, put, self._steer)
        self._commands = Commands(self._gui, session, put, self._command)
        with controls.plots:
            self._front = FrontView(self._gui, session, put)
            self._charts = Charts(server, session)
        self._offer()

    @property
    def steered(self) -> Session:
        """The robot that the sliders steer."""
        return self._lineup.steered

    @property
    def behaviors(self) -> Sequence[Behavior]:
        """The robots to show and to move."""
        compared = self._finding.behaviors if self._finding else ()
        return compared or self._lineup.sessions

    @property
    def names(self) -> Sequence[str]:
        """A name for each of several robots; one robot alone has none."""
        return self._lineup.names() if self._shows_lineup else NAMES

    def act(self, action: str) -> None:
        """Do what a button of the controls says."""
        if action == FIND:
            self._find()
        elif action == ADD:
            self._lineup.add()
            self._offer()
        elif action == DROP:
            self._lineup.remove()
            self._offer()
        elif action == RESET:
            for behavior in self.behaviors:
                behavior.reset()
        elif action == SHOVE:
            for session in self._all_sessions():
                session.push()

    def select(self, index: int) -> None:
        """Steer another robot."""
        if index < len(self._lineup.sessions):
            self._lineup.selected = index
            self._folders.show(self.steered.tradeoff)

    def mark(self) -> None:
        """Show the current trade-offs on the sliders and in the drawing, if they have changed."""
        lineup, levels = self._lineup, self._folders.levels
        tradeoffs = [session.tradeoff for session in lineup.sessions]
        marked = (tradeoffs, lineup.selected, levels, self._front.drawing)
        if marked != self._marked:
            self._marked = marked
            self._front.mark(lineup.sessions, lineup.selected, levels)
            self._folders.show(lineup.steered.tradeoff, field=False)

    def report(self) -> None:
        """Show the robots' returns and charts; "A or B?" is to be answered without numbers."""
        lineup = self._lineup
        if self._shows_lineup:
            self._charts.draw(lineup.steered)
            self._controls.report(status(lineup.sessions, lineup.selected))
        else:
            self._controls.report(None)

    def remove(self) -> None:
        """Remove the run's widgets from the page."""
        self._leave(None)
        for part in (self._folders, self._commands, self._front, self._charts):
            part.remove()

    @property
    def _shows_lineup(self) -> bool:
        return self.behaviors is self._lineup.sessions

    def _offer(self) -> None:
        """Offer what can be done with the robots that there are."""
        lineup, finding = self._lineup, self._finding is not None
        self._controls.offer(len(lineup.sessions), lineup.selected, finding)
        self._folders.reveal(not finding)
        self._folders.show(lineup.steered.tradeoff)

    def _steer(self, tradeoff: Weights) -> None:
        self.steered.tradeoff = tradeoff

    def _command(self, index: int, value: float) -> None:
        for session in self._all_sessions():
            session.tell(index, value)

    def _find(self) -> None:
        """Enter the mode "A or B?"."""
        if self._finding is None:
            self._finding = Finding(self._gui, self.steered, self._put, self._leave)
            self._offer()

    def _leave(self, tradeoff: Weights | None) -> None:
        """Leave the mode "A or B?"; with a trade-off, go on with it."""
        if self._finding is not None:
            self._finding.remove()
            self._finding = None
            if tradeoff is not None:
                self._folders.jump(tradeoff)
            self._offer()

    def _all_sessions(self) -> list[Session]:
        compared = [b for b in self.behaviors if isinstance(b, Session)]
        return list({*self._lineup.sessions, *compared})
