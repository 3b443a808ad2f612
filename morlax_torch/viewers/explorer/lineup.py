"""Up to four robots of one run, of which users steer one, and the body that all of them have."""

import threading

from ...envs import MorlaxError
from ...evaluation.front import Front
from ...networks.policy import Policy
from ...runs.evaluating import evaluate
from .session import Put, Session

MOST = 4  # robots
TRADEOFFS = 33  # of the front of a new body: few, so that it follows soon


class Lineup:
    """The robots of a run; `stale` is whether the page shows the front of a former body."""

    def __init__(self, session: Session, put: Put):
        self.sessions, self.selected = [session], 0
        self.stale = False
        self._put, self._measuring, self._waiting = put, False, False

    @property
    def steered(self) -> Session:
        """The selected robot."""
        return self.sessions[self.selected]

    def add(self) -> None:
        """Add a robot with the selected one's trade-off and select it; all start anew."""
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

    def reshape(self, index: int, value: float) -> None:
        """Set one design parameter of all robots; it is clamped to its range."""
        policy, design = self.steered.player.policy, self.steered.design
        parameters = policy.agent.designs
        _, low, high, _ = list(parameters.values())[index]
        design[index] = min(max(value, low), high)
        policy = policy.for_design(dict(zip(parameters, design, strict=True)))
        for session in self.sessions:
            session.reshape(policy)
        self.stale = True

    def measure(self) -> None:
        """Evaluate the front of the robots' body in another thread, one body after the other."""
        if self._measuring:
            self._waiting = True
            return
        self._measuring, policy = True, self.steered.player.policy

        def work() -> None:
            front: Front | MorlaxError
            try:
                front = evaluate(policy, TRADEOFFS, device="cpu")
            except MorlaxError as error:  # raised again where it can be shown
                front = error
            self._put(lambda: self._end(policy, front))

        threading.Thread(target=work, daemon=True).start()

    def _end(self, policy: Policy, front: Front | MorlaxError) -> None:
        """Show the front of a body, unless the robots have another body by now."""
        self._measuring, waiting, self._waiting = False, self._waiting, False
        if isinstance(front, Front) and self.steered.player.policy is policy:
            front, self.stale = front._replace(checkpoint="this body"), False
            for session in self.sessions:
                session.measured(front)
        if waiting and self.stale:
            self.measure()
        if isinstance(front, MorlaxError):
            raise front
