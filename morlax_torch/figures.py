"""What people look at."""

from itertools import combinations

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .evaluation import Front

COLOURS = "viridis"  # even in lightness: readable in grey and by the colour-blind


def front_figure(front: Front, title: str = "") -> Figure:
    """The returns of every trade-off, coloured by it, and the front: one plot for each pair."""
    pairs = list(combinations(range(len(front.objectives)), 2))
    columns = min(len(pairs), 3)
    rows = -(-len(pairs) // columns)
    figure = Figure(figsize=(0.9 + 4.6 * columns, 4.2 * rows), layout="constrained")
    figure.suptitle(title)
    for index, (x, y) in enumerate(pairs):
        _pair(figure.add_subplot(rows, columns, index + 1), front, x, y)
    return figure


def _pair(axes: Axes, front: Front, x: int, y: int) -> None:
    best = front.non_dominated
    share = front.tradeoffs[:, x] / (front.tradeoffs[:, [x, y]].sum(1) + 1e-12)
    axes.scatter(*front.returns[~best][:, [x, y]].T, s=8, color="0.8", label="dominated")
    points = axes.scatter(
        *front.returns[best][:, [x, y]].T, s=14, c=share[best], cmap=COLOURS, vmin=0, vmax=1
    )
    axes.set_xlabel(f"{front.objectives[x]} (return)")
    axes.set_ylabel(f"{front.objectives[y]} (return)")
    axes.grid(alpha=0.3)
    axes.figure.colorbar(points, ax=axes, label=f"trade-off: share of {front.objectives[x]}")
    if not best.all():
        axes.legend(loc="lower left")
