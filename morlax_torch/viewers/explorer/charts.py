"""Strip charts of a session's last seconds."""

import numpy as np
import viser
from viser import uplot

from ...colors import of_objectives
from .session import Session

HEIGHT = 104
INK = "#212529"


class Charts:
    """Charts of running returns, velocity and power, added to the current GUI container."""

    def __init__(self, server: viser.ViserServer, session: Session):
        self._session = session
        m, k = len(session.objectives), len(session.axes)
        self._rows = (range(1, 1 + m), range(1 + m, 1 + m + k), range(1 + m + k, 2 + m + k))
        along = ("along x", "along y")
        self._charts = [
            _chart(server, "running returns", list(session.objectives), of_objectives(m)),
            _chart(server, "velocity (m/s)", list(along[:k]), [INK, "#868e96"]),
            _chart(server, "mechanical power (W)", ["power"], [INK]),
        ]

    def draw(self) -> None:
        """Show the session's current history."""
        columns = self._session.history.columns()
        if not columns.shape[1]:
            return
        for chart, rows in zip(self._charts, self._rows, strict=True):
            chart.data = (columns[0], *(columns[row] for row in rows))

    def remove(self) -> None:
        """Remove the charts from the page."""
        for chart in self._charts:
            chart.remove()


def _chart(
    server: viser.ViserServer, title: str, names: list[str], colors: list[str]
) -> viser.GuiUplotHandle:
    nothing = np.zeros(1)
    lines = [
        uplot.Series(label=name, stroke=color, width=1.5)
        for name, color in zip(names, colors, strict=False)
    ]
    return server.gui.add_uplot(
        (nothing,) * (1 + len(names)),
        (uplot.Series(label="time (s)"), *lines),
        title=title,
        scales={"x": uplot.Scale(time=False)},
        axes=tuple(uplot.Axis(size=size, ticks=uplot.Axis_Ticks(show=False)) for size in (30, 52)),
        legend=uplot.Legend(show=len(names) > 1, live=False),
        padding=(4, 12, 0, 0),
        height=HEIGHT,
    )
