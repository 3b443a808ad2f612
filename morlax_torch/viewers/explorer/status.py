"""The text lines of the page."""

from html import escape

from .session import Session

NO_FRONT = (
    '<p style="margin:0;padding:0 0.8em 0.6em;font-size:0.85em">This run has no front.npz to '
    "plot. To write one: <code>python -m morlax_torch.evaluate RUN</code></p>"
)


def status(session: Session) -> str:
    """Return durations and returns of this and the last episode, as HTML."""
    lines = [_episode(session, "this episode", session.seconds, session.player.returns.tolist())]
    last = session.last_episode
    if last is not None:
        end = "last episode (failed)" if last.fell else "last episode"
        lines.append(_episode(session, end, last.seconds, last.returns))
    return f'<div style="padding:0 0.8em 0.6em;font-size:0.85em">{"<br>".join(lines)}</div>'


def _episode(session: Session, name: str, seconds: float, returns: list[float]) -> str:
    sums = [f"{escape(o)} {r:,.0f}" for o, r in zip(session.objectives, returns, strict=True)]
    return f"<b>{name}</b> {seconds:.1f} s: {', '.join(sums)}"
