"""Up to three robots with one policy each of the same run, one of which users steer."""

from ...envs import MorlaxError
from .session import Session
from .weights import Weights

MOST = 3  # robots
FEW = 3  # objectives; names show the weights of no more


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

    def names(self) -> list[str]:
        """Return a name for each of several robots; one robot alone has none."""
        if len(self.sessions) == 1:
            return []
        names = [_name(i, session) for i, session in enumerate(self.sessions)]
        names[self.selected] = f"▸ {names[self.selected]}"
        return names


def _name(index: int, session: Session) -> str:
    return f"{index + 1}: {_brief(session.objectives, session.tradeoff)}"


def _brief(objectives: tuple[str, ...], weights: Weights) -> str:
    if len(weights) <= FEW:
        return ", ".join(f"{weight:.2f}" for weight in weights)
    top = max(range(len(weights)), key=weights.__getitem__)
    return f"{objectives[top]} {weights[top]:.2f}"
