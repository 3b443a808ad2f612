"""The evaluate command: single runs, comparisons, references, files and the report."""

import base64
import re
import shutil
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from same import csv_rows
from tiny import TYPED

from morlax_torch import MorlaxError, load
from morlax_torch.commands import evaluate
from morlax_torch.commands.terminal.arguments import read
from morlax_torch.commands.train import command as train
from morlax_torch.evaluation import pareto
from morlax_torch.evaluation.front import Front
from morlax_torch.reports.comparison import Evaluated, check_comparable, names, repeated
from morlax_torch.reports.page import cell
from morlax_torch.reports.verdict import verdict
from morlax_torch.runs import loading
from morlax_torch.runs.loading import evaluate as evaluate_run
from morlax_torch.runs.progress import History

FEW = ("--device", "cpu", "--tradeoffs", "6")
THREE = "env: hopper\ntask:\n  objectives: {run: {run: 1}, jump: {jump: 9}, up: {upright: 4}}\n"


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> Path:
    """Train runs of which tests get copies."""
    place = tmp_path_factory.mktemp("runs")
    (place / "three.yaml").write_text(THREE)
    for folder, arguments in {
        "a/hopper": ("--env", "hopper"),
        "b/hopper": ("--env", "hopper", "--seed", "1"),
        "discounted": ("--env", "hopper", "--evaluation.protocol", "discounted"),
        "noisy": ("--env", "hopper", "--task.reset-noise", "0.1"),
        "three": ("--config", str(place / "three.yaml")),
        "cheetah": ("--env", "cheetah"),
    }.items():
        train([*arguments, *TYPED, "--output", str(place / folder)])
    return place


@pytest.fixture
def workplace(runs, tmp_path, monkeypatch) -> Path:
    shutil.copytree(runs, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
def test_a_single_run_is_evaluated_into_its_own_folder(workplace, capsys, rendered):
    evaluate.command(["a/hopper", *FEW])
    folder = workplace / "a" / "hopper"
    for stem in ("front", "returns", "hypervolume"):
        assert (folder / f"{stem}.png").read_bytes().startswith(b"\x89PNG")
        assert (folder / f"{stem}.pdf").read_bytes().startswith(b"%PDF")
    (row,) = csv_rows(folder / "indicators.csv")
    front = Front.load(folder / "front.npz")
    assert (row["run"], row["path"], row["seed"]) == ("hopper", "a/hopper", "0")
    assert float(row["hypervolume"]) == pytest.approx(front.hypervolume)
    assert float(row["obedience"]) == pytest.approx(front.obeys.mean())
    assert float(row["episode_length"]) == pytest.approx(front.lengths.mean())
    assert float(row["run_max"]) == pytest.approx(front.returns[:, 0].max())
    assert float(row["jump_min"]) == pytest.approx(front.returns[:, 1].min())
    assert "igd_plus" not in row
    assert not (folder / "summary.csv").exists()
    assert "obedience" in capsys.readouterr().out
    marks = csv_rows(folder / "front.csv")
    assert [row["obeys"] for row in marks] == [str(int(obeys)) for obeys in front.obeys]
    assert {row["falls"] for row in marks} <= {"0", "1"}


def test_a_comparison_changes_neither_runs_nor_earlier_results(workplace, capsys):
    before = {path: path.stat().st_mtime_ns for path in workplace.rglob("*") if path.is_file()}
    for _ in range(2):
        evaluate.command(["a/hopper", "b/hopper", *FEW])
    folder, other = (workplace / "evaluations").iterdir()
    assert before == {path: path.stat().st_mtime_ns for path in before}
    assert (folder / "fronts.pdf").is_file() and (other / "fronts.pdf").is_file()

    fronts = {name: Front.load(folder / name / "front.npz") for name in ("a/hopper", "b/hopper")}
    assert not np.array_equal(*(front.returns for front in fronts.values()))
    union = pareto.front(np.concatenate([front.returns for front in fronts.values()]))
    found = {row["run"]: row for row in csv_rows(folder / "indicators.csv")}
    assert {row["seed"] for row in found.values()} == {"0", "1"}
    for name, front in fronts.items():
        expected = pareto.igd_plus(front.returns, union)
        assert float(found[name]["igd_plus"]) == pytest.approx(expected)
    assert "median of 2" in capsys.readouterr().out
    volumes = [front.hypervolume for front in fronts.values()]
    summary = {row["indicator"]: row for row in csv_rows(folder / "summary.csv")}["hypervolume"]
    columns = [float(summary[name]) for name in ("lower_quartile", "median", "upper_quartile")]
    assert columns == pytest.approx(np.percentile(volumes, (25, 50, 75)))
    assert summary["runs"] == "2"
    check_report((folder / "report.html").read_text())


def test_checkpoints_of_one_run_can_be_compared(workplace, capsys):
    checkpoints = [f"a/hopper/checkpoints/{name}.pt" for name in ("best", "latest")]
    evaluate.command([*checkpoints, *FEW, "--output", "out"])
    runs = [row["run"] for row in csv_rows("out/indicators.csv")]
    assert sorted(runs) == ["hopper-best", "hopper-latest"]
    assert "median" not in capsys.readouterr().out
    assert "<th>median</th>" not in Path("out/report.html").read_text()
    assert not Path("out/summary.csv").exists()


def test_runs_with_a_median_differ_only_in_their_seeds(make_policy):
    def repeat(**changes) -> bool:
        policies = make_policy(seed=1), make_policy(seed=2), make_policy(**{"seed": 3, **changes})
        runs = [Evaluated("", policy, front_of(ARC), None, {}) for policy in policies]
        return repeated(dict(enumerate(runs)))

    assert repeat() and repeat(evaluation={"every": 320}) and repeat(target=1e6)
    for changes in (
        {"seed": 2},
        {"worlds": 64},
        {"ppo": {"learning_rate": 1e-3}},
        {"evaluation": {"tradeoffs": 7}},
        {"network": {"features": 8}},
    ):
        assert not repeat(**changes), changes
    assert not repeated({"one": Evaluated("", make_policy(), front_of(ARC), None, {})})


def test_shipped_policies_are_not_written_to(workplace, monkeypatch):
    shipped = workplace / "shipped"
    shutil.copytree(workplace / "a" / "hopper", shipped / "jumper")
    monkeypatch.setattr(loading, "SHIPPED", shipped)
    before = sorted(shipped.rglob("*"))
    evaluate.command(["jumper", *FEW])
    assert sorted(shipped.rglob("*")) == before
    (folder,) = (workplace / "evaluations").iterdir()
    assert (folder / "report.html").is_file()


def test_a_reference_can_be_a_file_or_a_run(workplace):
    evaluate.command(["b/hopper", *FEW])
    found = []
    for reference in ("b/hopper/front.npz", "b/hopper"):
        evaluate.command(["a/hopper", *FEW, "--reference", reference])
        (row,) = csv_rows("a/hopper/indicators.csv")
        found.append(float(row["igd_plus"]))
    other = Front.load(Path("b/hopper/front.npz"))
    mine = Front.load(Path("a/hopper/front.npz"))
    assert found[0] == pytest.approx(pareto.igd_plus(mine.returns, pareto.front(other.returns)))
    assert found[1] == pytest.approx(found[0])


def test_several_seeds_average_episodes_with_different_starts(workplace):
    several = evaluate_run("noisy", 6, device="cpu", seeds=40)
    assert several.returns.shape == (6, 2)
    other = evaluate_run("noisy", 6, device="cpu", seeds=40, seed=1)
    single = [evaluate_run("noisy", 6, device="cpu", seed=seed).returns for seed in range(2)]
    spread = np.abs(single[0] - single[1]).mean()
    assert 0 < np.abs(several.returns - other.returns).mean() < spread
    loaded = evaluate_run(load("noisy"), 6, device="cpu")
    np.testing.assert_array_equal(loaded.returns, single[0])


class Assets(HTMLParser):
    def __init__(self, text: str):
        super().__init__()
        self.found: list[str] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)
        self.found += [
            value
            for name, value in attrs
            if name.split(":")[-1] in ("src", "href", "srcset") and value and value[0] != "#"
        ]
        assert tag not in ("link", "iframe")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def check_report(text: str) -> None:
    page = Assets(text)
    assert not page.open
    drawn = [asset for asset in page.found if asset.startswith("data:image/svg")]
    assert len(drawn) == 4  # fronts, hypervolume, and the returns of each run
    assert text.count("</svg>") == 2  # the front of each run
    assert len(page.found) - len(drawn) in (0, 1)  # the robot, where there is OpenGL
    assert all(asset.startswith("data:image/") for asset in page.found)
    for asset in drawn:
        assert asset.startswith("data:image/svg+xml;base64,")
        assert b"</svg>" in base64.b64decode(asset.partition(",")[2])
    assert not re.search(r"https?:|url\((?!#)|@import", text)
    assert text.index("Of 2 runs, ") < text.index("</svg>") < text.index("<h2>Indicators")
    assert "evaluate a/hopper b/hopper --device cpu" in text
    for words in ("hypervolume", "obedience", "IGD+", "learning_rate", "Objectives: run, jump"):
        assert words in text
    assert "color-scheme: light dark" in text
    for words in ("random seed", "algorithm", "training time", "trained on", "trained with"):
        assert text.index(words) < text.index("<h2>Indicators")


def test_each_point_of_a_report_tells_its_policy(workplace, rendered, capsys):
    evaluate.command(["three", *FEW])
    text = (workplace / "three" / "report.html").read_text()
    assert not Assets(text).open
    assert not re.search(r"https?:|url\((?!#)|@import", text)
    front = Front.load(workplace / "three" / "front.npz")
    told = re.findall(r'<a href="#(\d+)"><title>(.*?)</title>', text)
    assert Counter(int(index) for index, _ in told) == dict.fromkeys(range(6), 3)  # projections
    for index, about in told:
        weights, returns = front.tradeoffs[int(index)], front.returns[int(index)]
        names = front.objectives
        assert ", ".join(f"{n} {v:.2f}" for n, v in zip(names, weights, strict=True)) in about
        assert ", ".join(f"{n} {v:,.4g}" for n, v in zip(names, returns, strict=True)) in about
    said = " ".join(capsys.readouterr().out.split())
    (verdict,) = re.findall(r'<p class="verdict">(.*?)</p>', text)
    assert said.startswith(verdict)
    for policy in ("best run", "best jump", "best up", "knee", "balanced"):
        assert re.search(rf"<td>[^<]*\b{policy}\b", text), policy


def front_of(returns, falls: float = 0.0) -> Front:
    """Return a front of two objectives whose reference point is 0."""
    returns = np.array(returns, dtype=float)
    share = np.linspace(0, 1, len(returns))
    tradeoffs, K = np.stack([share, 1 - share], 1), len(returns)
    return Front(("run", "energy"), tradeoffs, returns, np.ones(K), np.zeros(2), np.full(K, falls))


ARC = [(100 * x, 100 * (1 - x**2)) for x in np.linspace(0.3, 0.9, 8)]
DOMINATED = [(1.0, 1.0)] * 60
VERDICTS = {
    "falls": (front_of(ARC, 1.0), "Every episode fails: train longer (--max-env-steps or"),
    "most falls": (front_of(ARC, 0.62), "62 % of the episodes fail: train longer"),
    "one policy": (front_of([*DOMINATED, (5, 5)]), "Only 1 of 61 policies is non-dominated: train"),
    "few": (front_of([*DOMINATED, (5, 6), (6, 5)]), "Only 2 of 62 policies are non-dominated: "),
    "narrow": (
        front_of([(99 + x / 100, y) for x, y in ARC]),
        "The returns of the front hardly differ in run: train longer",
    ),
    "infinite": (front_of([(np.inf, 1)] * 3), "No policy has finite returns: check"),
    "good": (
        front_of(ARC),
        "8 of 8 policies are non-dominated; from the best policy of run to that of energy, run "
        "falls by 67 % (90 to 30) and energy rises by 379 % (19 to 91).",
    ),
    "some falls": (front_of(ARC, 0.125), "(19 to 91); 12.5 % of the episodes fail."),
    "signs": (
        front_of([(-5, 3), (2, -1), (0, 0)]),
        "run falls (2 to -5) and energy rises (-1 to 3).",
    ),
}


@pytest.mark.parametrize("name", VERDICTS)
def test_a_verdict_tells_the_most_serious_finding(name):
    front, expected = VERDICTS[name]
    said = verdict(front, None)
    assert expected in said
    assert said.endswith(".") and "  " not in said


NO_FRONT = [(-2.153, -0.86), (-2.05, -1.359), (-2.1, -1.0)]
SAFER = [(5, -30), (20, -90), (60, -250)]


@pytest.mark.parametrize(("returns", "below"), [(NO_FRONT, [2]), (SAFER, [0, 2])])
def test_a_verdict_names_a_reference_point_that_returns_exceed(returns, below):
    """`below`: how many of the objectives' points may be lowered."""
    front = front_of(returns)
    said = verdict(front, None)
    assert front.hypervolume == 0
    assert said.startswith("No policy exceeds the reference point (run 0, energy 0) in every")
    assert "train longer" not in said and "pays" not in said
    option = re.search(r"--task\.reference-point ((?: ?-?[\d.]+)+)[, ]", said)
    point = np.array(option.group(1).split(), dtype=float)
    worst = front.returns.min(0)
    assert (point < worst).all() and (worst - point < 0.2 * abs(worst).max()).all()
    assert front._replace(reference_point=point).hypervolume > 0
    config = read(["--env", "cheetah", "--device", "cpu", *option.group().rstrip(", ").split()])[0]
    assert config.task.reference_point == tuple(point)


def test_a_verdict_tells_that_failing_early_pays():
    for returns, falls, pays in (
        (NO_FRONT, 0.5, "All returns of run and energy are negative"),
        (SAFER, 1.0, "All returns of energy are negative"),
        (SAFER, 0.0, None),  # episodes do not end early
        ([(5, 3), (20, -1), (-1, 4)], 0.9, None),
    ):
        said = verdict(front_of(returns, falls), None)
        if pays is None:
            assert "pays" not in said
        else:
            assert f"{pays} and some episodes fail, so failing early pays" in said


def test_a_verdict_tells_whether_the_hypervolume_still_rises():
    def curve(*volumes: float) -> History:
        steps = np.arange(len(volumes), dtype=float)
        return History(steps, steps, np.array(volumes))

    good = verdict(front_of(ARC), None)
    assert verdict(front_of(ARC), curve(0, 60, 90, 100, 108)) == (
        f"{good} The hypervolume still rose by 8 % over the last quarter of training: train longer "
        "(--max-env-steps or --max-seconds)."
    )
    assert "from 0 over the last 33 %" in verdict(front_of(ARC), curve(0, 0, 0, 7))
    for flat in (curve(0, 100, 100, 100, 101), curve(0, 50, 200, 100, 150), curve(0, 0, 0, 0)):
        assert verdict(front_of(ARC), flat) == good
    assert verdict(front_of(ARC), curve(0, 100)) == good  # too few evaluations to tell
    fallen = verdict(front_of(ARC, 1.0), curve(0, 60, 90, 100, 108))
    assert fallen.count("train longer") == 1 and "rose by 8 %" in fallen


def test_a_report_without_opengl_has_no_picture_of_the_robot(monkeypatch, rendered):
    from morlax_torch.viewers.filming.recording import Film, portrait

    def fail(*arguments, **options):
        raise MorlaxError("no OpenGL")

    monkeypatch.setattr(Film, "__init__", fail)
    assert portrait(load("hopper", "cpu")) is None


def test_names_in_a_report_of_three_objectives_are_escaped(workplace):
    shutil.copytree(workplace / "three", workplace / "<b>&")
    evaluate.command(["<b>&", *FEW])
    (row,) = csv_rows("<b>&/indicators.csv")
    assert {"run_min", "jump_max", "up_max"} <= set(row)
    text = (workplace / "<b>&" / "report.html").read_text()
    assert "<b>" not in text
    assert "&lt;b&gt;&amp;" in text


MISTAKES = {
    "": "name at least one run",
    "a/hopper ./a/hopper": "./a/hopper is given twice: name each run once",
    "a/hopper cheetah": "hopper and cheetah differ in their task (hopper and cheetah)",
    "a/hopper three": "hopper and three differ in their objectives (run, jump and run, jump, up)",
    "a/hopper noisy": "hopper and noisy differ in task.reset_noise",
    "a/hopper discounted": "hopper and discounted differ in evaluation.protocol (latched and",
    "a/hopper --reference discounted/front.npz": "run, jump by the protocol discounted, but",
    "a/hopper --seeds 3": "nothing in this task is random (task.reset_noise is 0",
    "three --tradeoffs 2 --protocol paper": "2 trade-offs are too few",
    "a/hopper --reference bad.npz": "bad.npz is damaged or not a front",
    "a/hopper --reference three/front.npz": "three/front.npz has the objectives run, jump, up by",
    "a/hopper --seed -1": "seed is -1: it must be an integer from 0",
}


@pytest.mark.parametrize("words", MISTAKES)
def test_a_mistake_prints_one_error_and_writes_nothing(words, workplace, refused):
    (workplace / "bad.npz").write_text("no front")
    assert MISTAKES[words] in refused(evaluate, *FEW, *words.split())


def test_an_output_that_is_a_file_is_refused_before_the_evaluation(workplace, refused, monkeypatch):
    monkeypatch.setattr(loading, "evaluate", None)
    (workplace / "used").touch()
    assert "cannot make used: File exists" in refused(evaluate, "a/hopper", "--output", "used")


def test_runs_are_named_by_the_shortest_unique_end_of_their_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for folder in ("x/a/0", "x/a/1", "x/b/0", "y/a/0"):
        Path(folder).mkdir(parents=True)
    assert names(["x/a/0"]) == ["0"]
    assert names(["x/a/0", "x/a/1"]) == ["0", "1"]
    assert names(["x/a/0", "x/b/0"]) == ["a/0", "b/0"]
    assert names(["x/a/0", "x/a/1", "y/a/0"]) == ["x/a/0", "x/a/1", "y/a/0"]
    Path("a", *tmp_path.parts[1:]).mkdir(parents=True)
    same = [str(tmp_path), str(Path("a", *tmp_path.parts[1:]))]  # one path is a suffix of the other
    assert not any(Path(name).is_absolute() for name in names(same))
    with pytest.raises(MorlaxError, match=r"x/a/\.\./a/0 is given twice"):
        names(["x/a/0", "x/b/0", "x/a/../a/0"])


def test_names_that_a_spreadsheet_would_run_are_quoted():
    names = ["=1+1", "+x", "-x", "@x", "\tx", "runs/a", "x=1"]
    assert [cell(name)[0] == "'" for name in names] == [True] * 5 + [False] * 2


def test_runs_are_compared_if_their_worlds_agree(make_policy):
    varied = make_policy(task={"randomization": {"mass": [0.8, 1.2]}})
    check_comparable({"even": make_policy(), "other": make_policy()})
    with pytest.raises(MorlaxError, match=r"even and varied differ in task\.randomization"):
        check_comparable({"even": make_policy(), "varied": varied})
