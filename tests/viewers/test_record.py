"""The record command writes videos, GIFs and film strips."""

import os
import re
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from growing import grow
from PIL import Image
from programs import python

from morlax_torch import Front, MorlaxError, load, save
from morlax_torch.commands import record
from morlax_torch.configuration.schedules import Schedule
from morlax_torch.runs.progress import kept_fronts
from morlax_torch.viewers.filming import recording
from morlax_torch.viewers.filming.growth import Growth
from morlax_torch.viewers.filming.panels import cycle, moments
from morlax_torch.viewers.filming.recording import Film, Sweep, write_video
from morlax_torch.viewers.player import Player

GAP = 4  # pixels between panels


@pytest.fixture
def saved(make_policy, workplace: Path) -> Path:
    """Write policy.pt into a temporary working directory."""
    save(make_policy(), workplace / "policy.pt")
    return workplace


SMALL = ("--width", "95", "--height", "65", "--seconds", "0.4")


@pytest.mark.slow
@pytest.mark.usefixtures("opengl")
@pytest.mark.parametrize(
    ("backend", "sentence"),
    [
        ("bogus", r"MuJoCo cannot be imported with MUJOCO_GL=bogus.*egl"),
        ("disabled", "OpenGL is not available"),
    ],
)
def test_without_opengl_the_error_is_one_line(backend, sentence, tmp_path):
    env = {**os.environ, "MUJOCO_GL": backend, "PYTHONPATH": os.pathsep.join(sys.path)}
    words = "-m", "morlax_torch", "record", "cheetah", "--output", "film.gif"
    done = python(*words, cwd=tmp_path, env=env)
    assert done.returncode == 2 and not done.stdout
    assert re.match(f"error: {sentence}", done.stderr) and done.stderr.count("\n") == 1
    assert not os.listdir(tmp_path)


@pytest.mark.slow
def test_an_mp4_plays_in_browsers_in_real_time(saved, capsys):
    record.command(["policy.pt", *SMALL])
    assert "written: film.mp4" in capsys.readouterr().out
    options = ["-i", "film.mp4", "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    done = subprocess.run([recording.find_ffmpeg(), *options], capture_output=True, check=True)
    about = re.search(r"Stream.*Video: (.*)", done.stderr.decode())[1]
    width, height = map(int, re.search(r" (\d\d+)x(\d+)", about).groups())
    frames = np.frombuffer(done.stdout, np.uint8).reshape(-1, height, width, 3)
    assert about.startswith("h264") and "yuv420p" in about
    assert " 25 fps" in about  # every fourth of 100 control steps per second
    assert frames.shape == (11, 66, 3 * 95 + 2 * GAP + 1, 3)  # even sizes; initial state included


@pytest.mark.usefixtures("opengl")
def test_a_png_suffix_writes_a_film_strip(saved, monkeypatch):
    tradeoffs = ("--tradeoff", "0.8,0.2", "--tradeoff", "1,3")
    strip = ("--output", "strip.png", "--pictures", "5")
    monkeypatch.setattr(recording, "find_ffmpeg", None)  # a PNG needs no ffmpeg
    record.command(["policy.pt", *SMALL, *tradeoffs, *strip])
    with Image.open("strip.png") as image:
        pixels = np.asarray(image)
    right = 5 * (95 + GAP) - GAP
    left = pixels.shape[1] - right
    assert pixels.shape[0] == 2 * (65 + GAP) - GAP and 0 < left < 200
    labels, rows = pixels[:, :left], (pixels[:65, left:], pixels[65 + GAP :, left:])
    assert labels.min() < 100 and (labels == 255).mean() > 0.7
    for row in rows:
        first, *_, last = (row[:50, x : x + 95] for x in range(0, right, 95 + GAP))  # no times
        assert (first != last).mean() > 0.05
    assert (rows[0] != rows[1]).mean() > 0.05


def test_a_strip_names_the_trade_off_of_each_row():
    over_time = Schedule(np.array([0.0, 1.0]), np.eye(2))
    film = Film(load("hopper"), [over_time, (3.0, 0.0), (0.996, 0.004)], 64, 64)
    labels = [take.label() for take in film._takes]
    assert labels == ["trade-off\nover time", "only run", "run 1.00\njump 0.00"]


@pytest.mark.usefixtures("opengl")
@pytest.mark.slow
def test_gifs_are_small(tmp_path):
    film = Film(load("cheetah"), [(1.0, 0.0)], 320, 240)
    assert [row[0] for row in film._takes[0]._table()] == ["run", "energy saved"]
    stride, fps = film.pace(1.0, recording.FASTEST[".gif"])
    frames = list(film.frames(1.0, stride))
    write_video(tmp_path / "film.gif", iter(frames), fps)
    assert fps == 20 and len(frames) == 21
    assert (tmp_path / "film.gif").stat().st_size < 190_000
    with Image.open(tmp_path / "film.gif") as image:
        assert image.n_frames == 21 and image.info["duration"] == 50  # milliseconds
        assert image.info["loop"] == 0  # forever
        image.seek(20)
        shown = np.asarray(image.convert("RGB")).astype(float)
    assert np.sqrt(np.square(shown - frames[20]).mean()) < 4  # of 255


@pytest.mark.usefixtures("opengl")
def test_a_sweep_goes_from_each_objective_to_the_next(make_policy, tmp_path):
    policy = make_policy()
    ramp = np.linspace(0, 1, 11)
    tradeoffs = np.stack([1 - ramp, ramp], 1)
    front = Front(
        policy.objectives, tradeoffs, 100 * tradeoffs, np.full(11, 500), np.zeros(2), np.zeros(11)
    )
    sweep = Sweep(policy, front, 96, 64)
    shares, frames = [], []
    for frame in sweep.frames(0.4, stride=8):
        shares.append(sweep._takes[0].player.tradeoff[1])
        frames.append(frame)
    np.testing.assert_allclose(shares, np.linspace(0, 1, 6), atol=1e-6)
    assert frames[0].shape == (64, 2 * 96 + GAP, 3)
    assert (frames[0][:, -96:] != frames[-1][:, -96:]).any()  # the mark has moved
    for output, chosen in (("strip.png", ()), ("film.mp4", [(1.0, 0.0)])):
        with pytest.raises(MorlaxError, match="a sweep needs no trade-off"):
            special = partial(Sweep, policy, front)
            recording.record(policy, tmp_path / output, chosen, special=special)


@pytest.mark.usefixtures("opengl")
def test_the_front_and_its_hypervolume_grow_in_a_film_of_training(tmp_path, make_run):
    run = make_run(tmp_path / "run", "hopper", "best")
    grow(run)
    film = Growth(load(run), kept_fronts(run), [], 192, 128, 0)
    frames = list(film.frames(1.0, stride=50))
    assert len(frames) == 3 and frames[0].shape == (2 * 128 + GAP, 2 * 192 + GAP, 3)
    plots = [(frame[:105, 33:192], frame[:105, -150:]) for frame in frames]
    colored = [np.argwhere(np.ptp(front.astype(int), 2) > 60) for front, _ in plots]
    assert colored[0][:, 1].max() < colored[-1][:, 1].max()  # to the right
    assert colored[0][:, 0].min() > colored[-1][:, 0].min()  # and up
    ink = [(curve.max(2) < 120).sum() for _, curve in plots]
    assert ink == sorted(ink) and ink[0] < ink[-1]
    again = list(film.frames(1.0, stride=50))
    assert all((one == other).all() for one, other in zip(frames, again, strict=True))


@pytest.mark.usefixtures("opengl")
@pytest.mark.slow
def test_a_fallen_robot_freezes_while_the_other_continues(make_policy):
    family, tradeoffs = make_policy(), [(1.0, 0.0), (0.0, 1.0)]
    fell = []
    for tradeoff in tradeoffs:
        player = Player(family, tradeoff)
        while not player.step().terminated:
            pass
        fell.append(player.steps)
    assert max(fell) < 400 and abs(fell[0] - fell[1]) > 10
    film = Film(family, tradeoffs, 64, 64)
    frames = list(film.frames(5.0, stride=10))
    assert len(frames) == 1 + -(-(max(fell) + 100) // 10)  # ends a second after the last fall
    first = fell.index(min(fell))
    panels = [frame[:, :64] if first == 0 else frame[:, -64:] for frame in frames]
    down = -(-min(fell) // 10)
    assert all((panel == panels[-1]).all() for panel in panels[down:])
    assert panels[down].mean() < panels[down - 1].mean() - 15  # dimmed
    assert (frames[down] != frames[down + 1]).any()


MISTAKES = {
    "nowhere": "nowhere does not exist",
    "policy.pt --tradeoff fast": "must be numbers, such as 0.5,0.5",
    "policy.pt --tradeoff 0,0": "not zero in every objective",
    "policy.pt --seconds 0": "at least one control step (0.01 s)",
    "policy.pt --seconds 1e8": "at most 3600 s, not 1e+08 s",
    "policy.pt --speed 1e-9": "the speed must be from 0.01 to 100",
    "policy.pt --width 0": "from 64 to 4096 pixels",
    "policy.pt --output film.avi": "must end in .mp4 or .gif",
    "policy.pt --training": "needs the fronts of two evaluations, but the run has kept 0",
    "policy.pt --training --sweep": "choose --sweep or --training",
}


@pytest.mark.parametrize("words", MISTAKES)
def test_a_mistake_gives_a_one_line_error_and_leaves_no_file(words, saved, refused):
    assert MISTAKES[words] in refused(record, *words.split())


def test_a_missing_extra_or_ffmpeg_is_named_in_the_error(saved, monkeypatch, refused):
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", "nowhere/ffmpeg")
    assert "set IMAGEIO_FFMPEG_EXE" in refused(record, "policy.pt")
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    assert "pip install 'morlax-torch[video]'" in refused(record, "policy.pt")


DT = 0.01


def swing(period: int, steps: int = 400, noise: float = 0.0) -> np.ndarray:
    """Return two joints (steps, 2) that swing with a period, and drift."""
    time = np.arange(steps)
    phase = 2 * np.pi * time / period
    joints = np.stack([np.sin(phase), 0.5 * np.cos(phase) + 0.3 * np.sin(2 * phase)], -1)
    shake = np.random.default_rng(0).normal(size=joints.shape)
    return 0.4 * joints + 0.001 * time[:, None] + noise * shake


@pytest.mark.parametrize("period", (12, 23, 40, 75, 150))
@pytest.mark.parametrize("noise", (0.0, 0.05))
def test_the_cycle_of_a_motion_is_found(period, noise):
    assert cycle(swing(period, noise=noise), DT) == pytest.approx(period, rel=0.03)


def test_a_robot_that_stands_or_stumbles_has_no_cycle():
    assert cycle(np.zeros((300, 3)), DT) is None
    assert cycle(np.zeros((300, 0)), DT) is None
    assert cycle(np.random.default_rng(0).normal(size=(300, 3)), DT) is None
    assert cycle(swing(20)[:3], DT) is None


def test_pictures_show_the_last_cycle_or_two():
    assert moments([swing(40)], DT, 9) == [[*range(359, 400, 5)]]
    (twice,) = moments([swing(12)], DT, 17)  # too few steps for 17 pictures
    assert twice[-1] == 399 and twice[-1] - twice[0] == 24
    still = np.zeros((400, 2))
    assert moments([still], DT, 5) == [[299, 324, 349, 374, 399]]  # one second
    assert moments([np.zeros((3, 2))], DT, 2) == [[0, 2]]
    fallen = swing(40)[:21]
    rows = moments([swing(40), swing(20), still, fallen], DT, 9)
    assert rows == [[*range(359, 400, 5)]] * 3 + [[0, 5, 10, 15, 20, 20, 20, 20, 20]]
