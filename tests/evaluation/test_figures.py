"""Figures label their axes for any number of objectives, and save valid files."""

from itertools import combinations

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from morlax_torch.configuration.tradeoffs import evaluation_tradeoffs
from morlax_torch.evaluation import figures
from morlax_torch.evaluation.figures import MOST_PAIRS, quartile_band
from morlax_torch.evaluation.front import Front, representatives
from morlax_torch.evaluation.style import colors_of, limits, of_objectives
from morlax_torch.reports.page import pictures
from morlax_torch.runs.progress import History

NAMES = ("run", "energy", "height", "jump")

pytestmark = pytest.mark.usefixtures("rendered")


def front(m: int, seed: int = 0) -> Front:
    """Return a front on a sphere, with some dominated policies."""
    tradeoffs = evaluation_tradeoffs(30, m).numpy()
    random = np.random.default_rng(seed)
    returns = tradeoffs / np.linalg.norm(tradeoffs, axis=1, keepdims=True)
    returns *= random.choice([100.0, 60.0], (30, 1), p=[0.7, 0.3])
    return Front(NAMES[:m], tradeoffs, returns, np.full(30, 500), np.zeros(m), np.zeros(30))


def drawn(figure: Figure) -> set[str]:
    figure.draw_without_rendering()
    return {text.get_text() for text in figure.findobj(lambda a: hasattr(a, "get_text"))}


def labels(figure: Figure) -> list[tuple[str, ...]]:
    """Return the axis labels of each plot: x, y and, in 3D, z."""
    return [
        tuple(getattr(axes, f"get_{axis}label")() for axis in "xyz" if hasattr(axes, f"{axis}axis"))
        for axes in figure.axes
    ]


@pytest.mark.parametrize("m", (2, 3, 4))
def test_a_front_has_a_plot_for_each_pair_of_objectives(m):
    figure = figures.front_figure(front(m), "a title")
    axes = [f"{name} (return)" for name in NAMES[:m]]
    assert set(combinations(axes, 2)) <= set(labels(figure))
    assert (tuple(axes) in labels(figure)) == (m <= 3)  # in 3D too
    assert {"a title", "dominated"} <= drawn(figure)
    if m == 2:
        assert any(y == "trade-off: weight of run" for _, y, *_ in labels(figure))  # the colorbar
    else:
        most = "all" if m == 3 else "most"
        assert {f"{most} weight on {name}" for name in NAMES[:m]} <= drawn(figure)


def test_returns_are_plotted_over_weights():
    first, second = labels(figures.returns_figure(front(2)))
    assert first == ("trade-off: weight of run", "run (return)")
    assert second == ("trade-off: weight of run", "energy (return)")
    maps = figures.returns_figure(front(3))  # of the simplex
    assert {"run only", "energy only", "height only"} <= drawn(maps)
    assert {x for x, *_ in labels(maps)} >= {f"{name} (return)" for name in NAMES[:3]}
    expected = [(f"trade-off: weight of {name}", f"{name} (return)") for name in NAMES]
    assert labels(figures.returns_figure(front(4))) == expected


@pytest.mark.parametrize("m", (2, 4))
def test_parallel_coordinates_have_one_scaled_axis_per_objective(m):
    some = front(m)
    figure = figures.parallel_figure(some)
    (axes,) = figure.axes
    ticks = [tick.get_text() for tick in axes.get_xticklabels()]
    assert ticks == [f"{name} (return)" for name in NAMES[:m]]
    best = some.returns[some.non_dominated]
    assert {f"{best[:, 0].max():.4g}", f"{best[:, 0].min():.4g}"} <= drawn(figure)
    lines = [line for line in axes.lines if line.get_alpha()]  # others are axes
    assert len(lines) == len(best)


@pytest.mark.parametrize("m", (2, 4))
def test_overlaid_fronts_have_different_markers(m):
    runs = {f"seed {seed}": front(m, seed) for seed in range(3)}
    figure = figures.fronts_figure(runs)
    assert set(runs) <= drawn(figure)
    assert len(figure.axes) == m * (m - 1) // 2
    for axes in figure.axes:
        assert len({line.get_marker() for line in axes.lines}) == 3
    assert labels(figure)[0] == ("run (return)", "energy (return)")


def wide(m: int) -> Front:
    """Return a front of many objectives, of which only the first two conflict."""
    tradeoffs = evaluation_tradeoffs(200, m).numpy()
    rising = np.linspace(0.0, 100.0, 200)[:, None] + np.zeros((1, m))
    rising[:, 0] = rising[::-1, 0]
    names = tuple(f"objective{k}" for k in range(m))
    return Front(names, tradeoffs, rising, np.full(200, 500), np.zeros(m), np.zeros(200))


def test_of_many_pairs_those_that_conflict_most_are_shown():
    figure = figures.front_figure(wide(6), "six")
    assert "six: the 6 of 15 pairs that conflict most" in drawn(figure)
    shown = [axes for axes in figure.axes if axes.get_xlabel()]
    assert len(shown) == MOST_PAIRS
    assert [axes.get_xlabel() for axes in shown[:5]] == ["objective0 (return)"] * 5


def test_an_objective_has_one_color_everywhere():
    some = front(3)
    corners = some._replace(tradeoffs=np.eye(3), returns=100 * np.eye(3), lengths=np.ones(3))
    palette = [to_rgb(color) for color in of_objectives(3)]
    assert colors_of(corners.tradeoffs).tolist() == pytest.approx(np.array(palette))
    for axes, color in zip(figures.returns_figure(front(4)).axes, of_objectives(4), strict=True):
        assert to_rgb(axes.spines["left"].get_edgecolor()) == pytest.approx(to_rgb(color))
        assert axes.collections[-1].get_facecolor()[0, :3] == pytest.approx(to_rgb(color))


def test_an_axis_leaves_out_values_far_away_and_says_so():
    values = np.linspace(0.0, 1.0, 200)
    assert limits(values) == pytest.approx((-0.04, 1.04))
    low, high = limits(np.append(values, 50.0))
    assert -0.1 < low < 0 and 1 < high < 1.5
    some = wide(4)
    far = some.returns.copy()
    far[:2] += 5000.0
    assert "2 outside" in drawn(figures.front_figure(some._replace(returns=far)))
    assert not any("outside" in text for text in drawn(figures.front_figure(some)))


def apart(figure: Figure) -> None:
    figure.draw_without_rendering()
    for axes in figure.axes:
        for axis in (getattr(axes, f"{x}axis") for x in "xyz" if hasattr(axes, f"{x}axis")):
            low, high = sorted(axis.get_view_interval())
            ticks = zip(axis.get_majorticklocs(), axis.get_ticklabels(), strict=False)
            shown = [label for place, label in ticks if low <= place <= high]
            placed = [label.get_window_extent() for label in shown if label.get_text()]
            for first, second in combinations(placed, 2):
                assert not first.overlaps(second), axis.get_label_text()


@pytest.mark.parametrize("m", (2, 3, 6))
def test_no_tick_labels_collide(m):
    some = wide(m)
    long = tuple(f"{name}_with_a_long_name" for name in some.objectives)
    for scale in (-1234567.0, 0.00012, 300.0):
        scaled = some._replace(returns=scale * (some.returns + 5), objectives=long)
        apart(figures.front_figure(scaled))
        apart(figures.fronts_figure({"a": scaled, "b": scaled}))
        apart(figures.returns_figure(scaled))
        apart(figures.parallel_figure(scaled))
    apart(figures.hypervolume_figure({"one": history((0, 0), (1.2e8, 3e18))}, False))


def test_representatives_are_the_extremes_the_knee_and_the_balanced_policy():
    returns = [[0, 100], [80, 90], [100, 0], [45, 91], [40, 40]]
    tradeoffs = [[0, 1], [0.7, 0.3], [1, 0], [0.2, 0.8], [0.5, 0.5]]
    arrays = np.array(tradeoffs), np.array(returns, dtype=float)
    some = Front(NAMES[:2], *arrays, np.ones(5), np.zeros(2), np.zeros(5))
    names = {2: "best run", 0: "best energy", 1: "knee", 4: "balanced"}
    assert representatives(some) == names
    one = some._replace(returns=np.ones((5, 2)))
    assert representatives(one) == {0: "best run, best energy, knee", 4: "balanced"}


def history(*points: tuple[float, float]) -> History:
    """Return a history of (seconds, hypervolume) points at 10 steps per second."""
    seconds, volume = np.array(points, dtype=float).T
    return History(10 * seconds, seconds, volume)


@pytest.mark.parametrize(("number", "repeated"), [(1, False), (3, True), (3, False)])
def test_hypervolume_is_plotted_over_steps_and_seconds(number, repeated):
    runs = {f"run {k}": history((0, 0), (10, 100 * k), (20, 200)) for k in range(number)}
    figure = figures.hypervolume_figure(runs, repeated)
    assert labels(figure) == [
        ("environment steps", "hypervolume"),
        ("training time (s)", ""),  # shares its y axis
    ]
    words = drawn(figure)
    assert ({"median of 3 runs", "interquartile range"} <= words) == repeated
    # a median of runs that differ in more than their seeds means nothing
    assert (runs.keys() <= words) == (number == 3 and not repeated)


def test_a_band_shows_quartiles_where_all_runs_have_data():
    runs = [[0, 4, 8], [0, 40, 80], [0, 400, 800]]
    band = quartile_band([(np.array([0.0, 1, 2]), np.array(y, dtype=float)) for y in runs])
    middle = [0, 40, 80]
    low, high = [0, (4 + 40) / 2, (8 + 80) / 2], [0, (40 + 400) / 2, (80 + 800) / 2]
    assert band.tolist() == [[0, 1, 2], low, middle, high]
    late = (np.array([0.5, 1.5]), np.array([10.0, 30.0]))
    x, _, middle, _ = quartile_band([(np.array([0.0, 1, 2]), np.array([0.0, 10, 20])), late])
    assert x.tolist() == [0.5, 1, 1.5]  # no extrapolation beyond a run's own range
    assert middle.tolist() == [7.5, 15, 22.5]


@pytest.mark.parametrize("m", (2, 3, 4))
def test_identical_policies_can_be_plotted(m):
    one = front(m)
    one = one._replace(returns=np.ones_like(one.returns))
    for draw in (figures.front_figure, figures.returns_figure, figures.parallel_figure):
        draw(one).draw_without_rendering()


@pytest.mark.parametrize("number", (0, 1, 2))
def test_quantities_may_be_few_and_not_finite(number):
    values = np.linspace(0, 1, 60).reshape(30, 2)
    values[3], names = np.nan, ("power (W)", "speed (m/s)")
    some = front(2)
    if number:
        some = some._replace(quantities=values[:, :number], quantity_names=names[:number])
    drawn = {name: figure for name, _, figure in pictures(some, "")}
    assert ("quantities" in drawn) == (number == 2)
    for figure in drawn.values():
        figure.draw_without_rendering()
