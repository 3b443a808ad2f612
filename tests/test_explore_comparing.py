"""The explorer's "A or B?": two behaviors side by side, and what is learned from answers."""

import signal
import threading
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
import pytest
from browsing import PATIENCE, Client, needs_page, serving

from morlax_torch import MorlaxError
from morlax_torch.configuration.config import load_config
from morlax_torch.configuration.files import read_yaml
from morlax_torch.viewers.explorer import library
from morlax_torch.viewers.explorer.comparisons import ClipComparisons, PolicyComparisons
from morlax_torch.viewers.explorer.session import Clip, Session
from morlax_torch.viewers.preferences.comparisons import Comparisons

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
    evidence = []
    for _ in range(9):
        question = source.ask()
        evidence.append(source.state())
        a, b = front.tradeoffs[list(question.policies)]
        source.answer(0 if a[0] > b[0] else 1)
    question = source.ask()
    evidence.append(source.state())
    index, tradeoff = source.best()
    run = front.returns[front.non_dominated, 0]
    assert front.returns[index, 0] > run.max() - 0.02 * np.ptp(run)
    assert tradeoff == pytest.approx(front.tradeoffs[index])
    # the evidence grows: fewer policies are possible, and fewer questions remain
    assert evidence[-1]["best"] == index and index in evidence[-1]["possible"]
    assert len(evidence[-1]["possible"]) < len(evidence[0]["possible"])
    assert evidence[-1]["confidence"] > evidence[0]["confidence"]
    assert evidence[-1]["left"] < evidence[0]["left"]
    # its robots act on the question's trade-offs
    for robot, asked in zip(question.behaviors, question.policies, strict=True):
        robot.step()
        assert robot.player.tradeoff.tolist() == pytest.approx(front.tradeoffs[asked])
        assert robot.seconds == pytest.approx(robot.dt)


# clips on a page


@pytest.fixture
def asked(model) -> Iterator[tuple[str, list[tuple[int, int]]]]:
    """Serve two pairs of clips; yields the page's address and the answers so far."""
    needs_page()
    from morlax_torch.viewers.explorer.exhibits import ComparisonExhibit
    from morlax_torch.viewers.explorer.page import Page

    answers: list[tuple[int, int]] = []
    ways = [np.linspace([0, 0], [0, end], 20) for end in (1.0, -1.0, 0.5)]
    pairs = [(ways[0], ways[1]), (ways[2], ways[0])]
    source = ClipComparisons(model, 0.05, pairs, lambda *answer: answers.append(answer))
    page, ended = Page(lambda _: ComparisonExhibit(source), "127.0.0.1", 0), threading.Event()
    thread = threading.Thread(target=page.serve, args=(ended.is_set,))
    thread.start()
    yield page.address, answers
    ended.set()
    thread.join()
    page.stop()


def wait_for_answers(client: Client, number: int) -> None:
    client.until(lambda: client.state["asking"]["answers"] == number, "no effect")


def test_recorded_clips_can_be_compared(asked):
    address, answers = asked
    client = Client(address)
    assert len(client.poses) == 2 and client.about["objectives"] == []
    client.send("answer", preferred=2)  # is not offered
    client.send("answer", preferred=1)
    wait_for_answers(client, 1)
    assert answers == [(0, 1)]
    client.moves()
    client.send("pause", on=True)
    client.until(lambda: client.state["paused"], "it is not paused")
    client.send("press", name="reset")
    client.until(lambda: client.poses[0][2, 2] == client.poses[1][2, 2] == 0, "no beginning")
    client.send("pause", on=False)
    client.send("answer", preferred=0)
    client.until(lambda: client.state["asking"]["over"], "there is no end")
    assert answers == [(0, 1), (1, 0)]
    client.send("answer", preferred=0)
    client.moves()
    assert len(answers) == 2
    client.close()


def test_a_skipped_question_is_not_answered(asked):
    address, answers = asked
    client = Client(address)
    client.send("press", name="skip")
    client.send("answer", preferred=0)
    wait_for_answers(client, 1)
    assert answers == [(1, 0)]
    client.close()


@pytest.mark.slow
def test_an_objective_is_taught_by_answers(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ("cheetah", "lesson", "--objective", "tall", "--clips", "12", "--answers", "12")
    with serving("teach", *words) as (address, process):
        comparisons, random = Comparisons.load(Path("lesson/comparisons.npz")), _draws()
        height = comparisons.clips.terms[:, comparisons.terms.index("height")]
        client = Client(address)
        for number in range(12):
            wait_for_answers(client, number)
            a, b = comparisons.pair(random)  # the clips that the page shows
            comparisons.answer(*((a, b) if height[a] > height[b] else (b, a)))
            client.send("answer", preferred=0 if height[a] > height[b] else 1)
        client.until(lambda: client.state["asking"]["over"], "there is no end")
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
