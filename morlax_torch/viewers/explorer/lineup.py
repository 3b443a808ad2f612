"""Up to four robots with one policy each of the same run, one of which users steer."""

from ...envs import MorlaxError
from .session import Session

MOST = 4  # robots


class Lineup:
    """The robots of a run.

    Args:
        session: the first of them.
    """

    def __init__(self, session: Session):
        self.sessions, self.selected = [session], 0

    @property
    def steered(self) -> Session:
        """The selected robot."""
        return self.sessions[self.selected]

    def add(self) -> None:
        """Add a robot with the selected one's trade-off and select it; all start anew.

        Raises:
            MorlaxError: there are `MOST` robots.
        """
        if len(self.sessions) == MOST:
            raise MorlaxError(f"the page shows at most {MOST} robots: remove one first.")
        self.sessions.append(self.steered.twin())
        self.selected = len(self.sessions) - 1
        for session in self.sessions:
            session.reset()

    def remove(self) -> None:
        """Remove the selected robot, unless it is the only one."""
        if len(self.sessions) > 1:
            del self.sessions[self.selected]
            self.selected = min(self.selected, len(self.sessions) - 1)
