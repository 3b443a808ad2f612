"""Figures label their axes for any number of objectives, and save valid files."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from morlax_torch import MorlaxError
from morlax_torch.evaluation import figures
from morlax_torch.evaluation.figures.hypervolume import Band
from morlax_torch.evaluation.front import Front
from morlax_torch.evaluation.history import History
from morlax_torch.tradeoffs import evaluation_tradeoffs

NAMES = ("run", "energy", "height", "jump")


def front(m: int, seed: int = 0) -> Front:
    """Return a front on a sphere, with some dominated policies."""
    tradeoffs = evaluation_tradeoffs(30, m).numpy()
    random = np.random.default_rng(seed)
    returns = tradeoffs / np.linalg.norm(tradeoffs, axis=1, keepdims=True)
    returns *= random.choice([100.0, 60.0], (30, 1), p=[0.7, 0.3])
    return Front(NAMES[:m], tradeoffs, returns, np.full(30, 500), np.zeros(m), np.zeros(30))


def drawn(figure: Figure) -> set[str]:
    """Draw a figure and return all its text."""
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
    pairs = [
        (f"{NAMES[x]} (return)", f"{NAMES[y]} (return)") for x in range(m) for y in range(x + 1, m)
    ]
    assert set(pairs) <= set(labels(figure))
    assert {"a title", "dominated"} <= drawn(figure)
    assert any(y.startswith("trade-off") for _, y, *_ in labels(figure))  # the colorbar


def test_three_objectives_get_a_3d_plot():
    space = ("run (return)", "energy (return)", "height (return)")
    assert space in labels(figures.front_figure(front(3)))


def test_the_legend_omits_dominated_if_no_policy_is():
    whole = front(2)
    whole = whole._replace(returns=100 * whole.tradeoffs)
    assert whole.non_dominated.all()
    assert "dominated" not in drawn(figures.front_figure(whole))
    assert "dominated" not in drawn(figures.returns_figure(whole))


def test_returns_of_two_objectives_are_plotted_over_the_first_weight():
    first, second = labels(figures.returns_figure(front(2)))
    assert first[1] == "run (return)"
    assert second == ("trade-off: weight of run", "energy (return)")


def test_returns_of_three_objectives_are_maps_of_the_simplex():
    figure = figures.returns_figure(front(3))
    assert {"run only", "energy only", "height only"} <= drawn(figure)
    assert {x for x, *_ in labels(figure)} >= {f"{name} (return)" for name in NAMES[:3]}


def test_returns_of_more_objectives_are_plotted_over_their_own_weights():
    expected = [(f"trade-off: weight of {name}", f"{name} (return)") for name in NAMES]
    assert labels(figures.returns_figure(front(4))) == expected


@pytest.mark.parametrize("m", (2, 3, 4))
def test_parallel_coordinates_have_one_scaled_axis_per_objective(m):
    some = front(m)
    figure = figures.parallel_figure(some)
    (axes,) = figure.axes
    ticks = [tick.get_text() for tick in axes.get_xticklabels()]
    assert ticks == [f"{name} (return)" for name in NAMES[:m]]
    best = some.returns[some.non_dominated]
    assert {f"{best[:, 0].max():.4g}", f"{best[:, 0].min():.4g}"} <= drawn(figure)
    lines = [path for lines in axes.collections for path in lines.get_paths()]
    assert len(lines) == len(best)


@pytest.mark.parametrize("m", (2, 3, 4))
def test_overlaid_fronts_have_different_markers(m):
    runs = {f"seed {seed}": front(m, seed) for seed in range(3)}
    figure = figures.fronts_figure(runs)
    assert set(runs) <= drawn(figure)
    assert len(figure.axes) == m * (m - 1) // 2
    for axes in figure.axes:
        assert len({line.get_marker() for line in axes.lines}) == 3
    assert labels(figure)[0] == ("run (return)", "energy (return)")


def history(*points: tuple[float, float]) -> History:
    """Return a history of (seconds, hypervolume) points at 10 steps per second."""
    seconds, volume = np.array(points, dtype=float).T
    return History(10 * seconds, seconds, volume)


@pytest.mark.parametrize("number", (1, 3))
def test_hypervolume_is_plotted_over_steps_and_seconds(number):
    runs = [history((0, 0), (10, 100 * k), (20, 200)) for k in range(number)]
    figure = figures.hypervolume_figure(runs)
    assert labels(figure) == [
        ("environment steps", "hypervolume"),
        ("training time (s)", ""),  # shares its y axis
    ]
    words = drawn(figure)
    assert ({"median of 3 runs", "interquartile range"} <= words) == (number == 3)


def test_a_band_shows_quartiles_where_all_runs_have_data():
    runs = [[0, 4, 8], [0, 40, 80], [0, 400, 800]]
    band = Band.over([(np.array([0.0, 1, 2]), np.array(y, dtype=float)) for y in runs])
    assert band.x.tolist() == [0, 1, 2]
    assert band.middle.tolist() == [0, 40, 80]
    assert band.low.tolist() == [0, (4 + 40) / 2, (8 + 80) / 2]
    assert band.high.tolist() == [0, (40 + 400) / 2, (80 + 800) / 2]
    late = (np.array([0.5, 1.5]), np.array([10.0, 30.0]))
    band = Band.over([(np.array([0.0, 1, 2]), np.array([0.0, 10, 20])), late])
    assert band.x.tolist() == [0.5, 1, 1.5]  # no extrapolation beyond a run's own range
    assert band.middle.tolist() == [7.5, 15, 22.5]


@pytest.mark.parametrize("m", (2, 3, 4))
def test_identical_policies_can_be_plotted(m):
    one = front(m)
    one = one._replace(returns=np.ones_like(one.returns))
    for draw in (figures.front_figure, figures.returns_figure, figures.parallel_figure):
        draw(one).draw_without_rendering()
    figures.fronts_figure({"one": one}).draw_without_rendering()


def test_figures_are_saved_as_png_pdf_and_svg(tmp_path: Path):
    figure = figures.front_figure(front(2))
    figures.save(figure, tmp_path / "a.front", ("png", "pdf", "svg"))
    starts = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}
    for ending, start in starts.items():
        assert (tmp_path / f"a.front.{ending}").read_bytes().startswith(start)
    assert len(list(tmp_path.iterdir())) == 3
    with pytest.raises(MorlaxError, match="cannot write"):
        figures.save(figure, tmp_path / "nowhere" / "front")


def test_a_run_s_history_is_read_from_its_metrics(tmp_path: Path):
    path = tmp_path / "metrics.csv"
    path.write_text(
        "iteration,env_steps,train_seconds,hypervolume_approximate\n0,0,0.0,5.5\n3,90,1.5,7\n"
    )
    read = History.load(path)
    assert [column.tolist() for column in read] == [[0, 90], [0, 1.5], [5.5, 7]]


@pytest.mark.parametrize("text", ("", "env_steps\n", "a,b\n1,2\n", "hypervolume\nmany\n"))
def test_damaged_metrics_are_an_error(tmp_path: Path, text):
    path = tmp_path / "metrics.csv"
    with pytest.raises(MorlaxError, match=r"there is no training curve .*metrics\.csv"):
        History.load(path)
    path.write_text(text)
    with pytest.raises(MorlaxError, match=r"metrics\.csv is damaged"):
        History.load(path)
