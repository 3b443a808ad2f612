"""Strip charts of a session's last seconds."""

import numpy as np
import viser
from numpy.typing import NDArray
from viser import uplot

from ...colors import of_objectives
from .session import Session

HEIGHT = 92
LABEL = 14  # px more for the name of the time axis
GRAYS = ("#868e96", "#ced4da")  # readable on light and on dark pages
END = "#adb5bd"


class Charts:
    """Charts of running returns, velocity and power, added to the current GUI container.

    Vertical lines are the ends of episodes.
    """

    def __init__(self, server: viser.ViserServer, session: Session):
        m, k = len(session.objectives), len(session.axes)
        self._rows = (range(1, 1 + m), range(1 + m, 1 + m + k), range(1 + m + k, 2 + m + k))
        along = ("along x", "along y")
        self._charts = [
            _chart(server, "running returns", list(session.objectives), of_objectives(m)),
            _chart(server, "velocity (m/s)", list(along[:k]), list(GRAYS), legend=k > 1),
            _chart(server, "mechanical power (W)", ["power"], list(GRAYS), timed=True),
        ]

    def draw(self, session: Session) -> None:
        """Show a session's current history."""
        columns, ends = session.history.columns(), session.history.ends()
        if not columns.shape[1]:
            return
        for chart, rows in zip(self._charts, self._rows, strict=True):
            chart.data = tuple(with_ends(columns[[0, *rows]], ends))

    def remove(self) -> None:
        """Remove the charts from the page."""
        for chart in self._charts:
            chart.remove()


def with_ends(columns: NDArray[np.float64], ends: list[float]) -> NDArray[np.float64]:
    """Add a signal that shows the ends of episodes as vertical lines.

    Args:
        columns: (1 + signals, T) times and signals.
        ends: times of the last sample of each episode that ended.

    Returns:
        (2 + signals, T'): times, the added signal, and the others. At an end, time stands still
        while the added signal goes from the least value to the greatest and back, and the others
        jump from the last value of one episode to the first of the next.
    """
    low, high = (float(f(columns[1:], initial=0.0)) for f in (np.min, np.max))
    at = np.searchsorted(columns[0], ends, side="right")
    at = at[at < columns.shape[1]]
    repeated = np.insert(columns, np.repeat(at, 3), columns[:, np.repeat(at, 3)], axis=1)
    marks = np.full(repeated.shape[1], low)
    for number, index in enumerate(at):
        first = index + 3 * number  # of the three added samples
        repeated[1:, first : first + 2] = columns[1:, [index - 1]]
        repeated[0, first : first + 3] = columns[0, index]
        marks[first + 1] = high
    return np.vstack([repeated[:1], marks, repeated[1:]])


def _chart(
    server: viser.ViserServer,
    title: str,
    names: list[str],
    colors: list[str],
    legend: bool = False,
    timed: bool = False,
) -> viser.GuiUplotHandle:
    nothing = np.zeros(1)
    lines = [
        uplot.Series(label=name, stroke=color, width=1.5)
        for name, color in zip(names, colors, strict=False)
    ]
    ends = uplot.Series(label="end of an episode", stroke=END, width=1.0)
    ticks = uplot.Axis_Ticks(show=False)
    time = uplot.Axis(size=28, ticks=ticks)
    if timed:
        time = uplot.Axis(size=26, ticks=ticks, label="time (s)", labelSize=LABEL, labelGap=0)
    return server.gui.add_uplot(
        (nothing,) * (2 + len(names)),
        (uplot.Series(label="time (s)"), ends, *lines),
        title=title,
        scales={"x": uplot.Scale(time=False)},
        axes=(time, uplot.Axis(size=52, ticks=ticks)),
        legend=uplot.Legend(show=legend, live=False),
        padding=(8, 12, 0, 0),
        height=HEIGHT + LABEL * timed,
    )
