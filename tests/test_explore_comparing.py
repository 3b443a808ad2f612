"""The explorer's "A or B?": two behaviors side by side, and what is learned from answers."""

import signal
import threading
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
import pytest
from browsing import PATIENCE, Client, View, chromium, exploring, serving

from morlax_torch import MorlaxError
from morlax_torch.configuration.config import load_config
from morlax_torch.configuration.files import read_yaml
from morlax_torch.evaluation.front import Front
from morlax_torch.preferences.comparisons import Comparisons
from morlax_torch.runs.loading import find_run
from morlax_torch.viewers.explorer import library
from morlax_torch.viewers.explorer.clip import Clip
from morlax_torch.viewers.explorer.comparisons import ClipComparisons, PolicyComparisons
from morlax_torch.viewers.explorer.session import Session

BOXES = """
<mujoco><worldbody>
  <body><joint type="slide" axis="1 0 0"/><geom type="box" size=".1 .1 .1"/></body>
  <body><joint type="slide" axis="0 0 1"/><geom type="box" size=".1 .1 .1"/></body>
</worldbody></mujoco>
"""


@pytest.fixture
def model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(BOXES)


# without a browser


def test_a_clip_repeats_its_positions_in_real_time(model):
    clip = Clip(model, [[0.0, 0.0], [0.0, 0.1], [0.0, 0.2]], dt=0.05)
    seen = []
    for _ in range(4):
        seen.append(clip.data.xpos[2, 2])
        clip.step()
    assert seen == pytest.approx([0.0, 0.1, 0.2, 0.0])
    clip.advance(0.0)
    clip.pace = 0.5
    assert sum(clip.advance(tick / 100) for tick in range(1, 101)) == 10
    clip.reset()
    assert clip.data.xpos[2, 2] == 0.0


@pytest.mark.parametrize("qpos", [[[0.0]], [], [0.0, 0.0], [[np.nan, 0.0]]])
def test_a_clip_that_does_not_fit_the_robot_is_an_error(model, qpos):
    with pytest.raises(MorlaxError, match="a clip needs"):
        Clip(model, qpos, dt=0.05)


def test_answers_move_the_recommendation_to_the_preferred_end():
    session = Session.open(library.choose("cheetah"))
    front = session.front
    source = PolicyComparisons(front, (session.twin(), session.twin()))
    for _ in range(9):
        question = source.ask()
        a, b = question.tradeoffs
        source.answer(0 if a[0] > b[0] else 1)
    index, tradeoff = source.best()
    run = front.returns[front.non_dominated, 0]
    assert front.returns[index, 0] > run.max() - 0.02 * np.ptp(run)
    assert tradeoff == pytest.approx(front.tradeoffs[index])
    # its robots act on the question's trade-offs
    for robot, asked in zip(question.behaviors, question.tradeoffs, strict=True):
        robot.step()
        assert robot.player.tradeoff.tolist() == pytest.approx(asked)
        assert robot.seconds == pytest.approx(robot.dt)


# clips on a page


@pytest.fixture
def asked(model) -> Iterator[tuple[str, list[tuple[int, int]]]]:
    """Serve two pairs of clips; yields the page's address and the answers so far."""
    pytest.importorskip("viser", reason="the extra [explore] is not installed")
    from morlax_torch.viewers.explorer.comparing import ComparisonPage

    answers: list[tuple[int, int]] = []
    ways = [np.linspace([0, 0], [0, end], 20) for end in (1.0, -1.0, 0.5)]
    pairs = [(ways[0], ways[1]), (ways[2], ways[0])]
    source = ClipComparisons(model, 0.05, pairs, lambda *answer: answers.append(answer))
    page, ended = ComparisonPage(source, "127.0.0.1", 0), threading.Event()
    thread = threading.Thread(target=page.serve, args=(ended.is_set,))
    thread.start()
    yield page.address, answers
    ended.set()
    thread.join()
    page.stop()


def test_recorded_clips_can_be_compared(asked):
    address, answers = asked
    client = Client(address, label="I prefer")
    client.until(lambda: client.names() == ["A", "B"], "A and B have no names")
    client.set("I prefer", "C")  # is not offered
    client.set("I prefer", "B")
    client.until(lambda: 'data-answers="1"' in client.html(), "the answer has no effect")
    assert answers == [(0, 1)]
    before = client.moves
    client.until(lambda: client.moves > before + 20, "the clips stand still")
    client.set("I prefer", "A")
    client.until(lambda: "nothing left to compare" in client.html(), "there is no end")
    assert answers == [(0, 1), (1, 0)]
    assert not client.widgets[client.uuid("I prefer")]["visible"]
    client.close()


def test_a_skipped_question_is_not_answered(asked):
    address, answers = asked
    client = Client(address, label="I prefer")
    client.set("I prefer", "skip")
    client.set("I prefer", "A")
    client.until(lambda: 'data-answers="1"' in client.html(), "the answer has no effect")
    assert answers == [(1, 0)]
    client.close()


@pytest.mark.slow
def test_an_objective_is_taught_by_answers(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ("cheetah", "lesson", "--objective", "tall", "--clips", "12", "--answers", "12")
    with serving("teach", *words) as (address, process):
        comparisons, random = Comparisons.load(Path("lesson/comparisons.npz")), _draws()
        height = comparisons.clips.terms[:, comparisons.terms.index("height")]
        client = Client(address, label="I prefer")
        for number in range(12):
            client.until(lambda n=number: f'data-answers="{n}"' in client.html(), "no question")
            a, b = comparisons.pair(random)  # the clips that the page shows
            comparisons.answer(*((a, b) if height[a] > height[b] else (b, a)))
            client.set("I prefer", "A" if height[a] > height[b] else "B")
        client.until(lambda: "nothing left to compare" in client.html(), "there is no end")
        client.close()
        process.send_signal(signal.SIGINT)
        printed, complaint = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0 and not complaint
    assert "12 answers" in printed and "--config lesson/config.yaml" in printed
    assert Comparisons.load(Path("lesson/comparisons.npz")).answers == comparisons.answers
    assert load_config(read_yaml(Path("lesson/config.yaml"))).task.objectives["tall"]["learned"] > 0


def _draws() -> np.random.Generator:
    """Return the random numbers that a new lesson draws its pairs with."""
    return np.random.default_rng([0, 0])


# policies on the explorer's page


@pytest.mark.slow
def test_a_run_without_a_front_says_so(tmp_path, make_run):
    folder = make_run(tmp_path / "run", "hopper", "best")
    (folder / "front.npz").unlink()
    sentence = "This checkpoint has no front."
    with exploring(str(folder)) as (address, _):
        client = Client(address)
        before = client.html().count(sentence)
        client.set("compare", "A or B?")
        client.until(lambda: client.html().count(sentence) == before + 1, "there is no sentence")
        assert "I prefer" not in client.labels()
        client.close()


@pytest.mark.slow
def test_a_browser_finds_the_preferred_tradeoff(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    front = Front.load(find_run("cheetah") / "front.npz")
    with exploring("cheetah") as (address, _), chromium() as browser:
        view = View(browser, address)
        view.press("A or B?")
        for number in range(9):
            view.until(lambda n=number: view.numbers("answers") == (n,), "no next question")
            a, b = view.numbers("a"), view.numbers("b")
            view.press("A" if a[0] > b[0] else "B")  # this user likes speed
        view.until(lambda: view.numbers("answers") == (9,), "the last answer has no effect")
        best = view.numbers("best")
        nearest = np.square(front.tradeoffs - best).sum(1).argmin()
        run = front.returns[front.non_dominated, 0]
        assert front.returns[nearest, 0] > run.max() - 0.02 * np.ptp(run)

        view.press("start again")
        view.until(lambda: view.numbers("answers") == (0,), "it does not start again")
        for _ in range(3):
            view.press("skip")
        assert view.tab.locator("[data-best]").count() == 0
        a, b = view.numbers("a"), view.numbers("b")
        view.press("A" if a[1] > b[1] else "B")  # this one saves energy
        view.tab.wait_for_selector("[data-best]")
        best = view.numbers("best")
        view.tab.screenshot(path=Path(tmp_path) / "asking.png")
        view.press("use this trade-off")
        view.until(lambda: view.tradeoff() == pytest.approx(best, abs=1e-3), "it is not used")
        view.until(lambda: view.slider("run") == round(best[0], 2), "the sliders do not follow")
        assert view.field() == ", ".join(f"{weight:.3f}" for weight in best)
        assert view.tab.get_by_role("button", name="skip").count() == 0
        assert view.errors == [] and view.elsewhere == []
