"""Change the body of a page's robots, and evaluate its front while they go on."""

import threading
from collections.abc import Callable, Sequence

from ...envs import MorlaxError
from ...evaluation.front import Front
from ...networks.policy import Policy
from ...runs.evaluating import evaluate
from .requests import Put
from .session import Session

TRADEOFFS = 33  # of a front: few, so that it follows soon


class Bodies:
    """The bodies of a family of policies that knows many.

    Args:
        put: queues a request.
        tell: called with a policy and its front, in the thread that moves the robots; returns
            whether the robots still have that body.
    """

    def __init__(self, put: Put, tell: Callable[[Policy, Front], bool]):
        self._put, self._tell = put, tell
        self.changed = False  # since the front that the page shows
        self._measuring = False
        self._next: Session | None = None  # whose body to evaluate after the present one

    def reshape(self, sessions: Sequence[Session], index: int, value: float) -> None:
        """Set one design parameter of all robots; it is clamped to its range.

        Raises:
            MorlaxError: there is no such body; the robots keep theirs.
        """
        policy = sessions[0].player.policy
        design, parameters = sessions[0].design, policy.agent.designs
        _, low, high, _ = list(parameters.values())[index]
        design[index] = min(max(value, low), high)
        other = policy.for_design(dict(zip(parameters, design, strict=True)))
        for session in sessions:
            session.reshape(other)
        self.changed = True

    def measure(self, session: Session) -> None:
        """Evaluate the front of a robot's body in another thread, one body after the other."""
        if self._measuring:
            self._next = session
            return
        self._measuring = True
        policy = session.player.policy

        def work() -> None:
            found: Front | MorlaxError
            try:
                found = evaluate(policy, TRADEOFFS, device="cpu")
            except MorlaxError as error:  # raised again where it can be shown
                found = error
            self._put(lambda: self._end(policy, found))

        threading.Thread(target=work, daemon=True).start()

    def _end(self, policy: Policy, found: Front | MorlaxError) -> None:
        self._measuring = False
        if isinstance(found, Front):
            self.changed = not self._tell(policy, found._replace(checkpoint="this body"))
        waiting, self._next = self._next, None
        if waiting is not None and self.changed:
            self.measure(waiting)
        if isinstance(found, MorlaxError):
            raise found
