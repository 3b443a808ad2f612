"""The text lines of the page."""

from collections.abc import Sequence
from html import escape

from .session import Session

NO_FRONT_TEXT = "This checkpoint has no front. To write one: <code>morlax evaluate RUN</code>"


def small(html: str) -> str:
    """Return lines of small text, as HTML."""
    return f'<div style="padding:0 0.8em 0.6em;font-size:0.85em">{html}</div>'


NO_FRONT = small(NO_FRONT_TEXT)


def status(sessions: Sequence[Session], selected: int) -> str:
    """Return durations and returns of this and the last episode, as HTML.

    Of several robots, each has a line for this episode; the selected one also for its last.
    """
    lines = []
    for number, session in enumerate(sessions):
        name = "this episode" if len(sessions) == 1 else f"robot {number + 1}"
        lines.append(_episode(session, name, session.seconds, session.player.returns.tolist()))
    last = sessions[selected].last_episode
    if last is not None:
        end = "last episode (failed)" if last.fell else "last episode"
        lines.append(_episode(sessions[selected], end, last.seconds, last.returns))
    return small("<br>".join(lines))


def _episode(session: Session, name: str, seconds: float, returns: list[float]) -> str:
    sums = [f"{escape(o)}&nbsp;{r:,.0f}" for o, r in zip(session.objectives, returns, strict=True)]
    return f"<b>{name}</b> {seconds:.1f} s: {', '.join(sums)}"
