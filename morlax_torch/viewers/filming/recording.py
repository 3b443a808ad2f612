"""Films and film strips of a robot under several trade-offs: H.264, animated GIF, or PNG."""

import math
import subprocess
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from copy import deepcopy
from fractions import Fraction
from io import BytesIO
from itertools import chain, product
from pathlib import Path
from shutil import which

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from ...configuration.schedules import Schedule
from ...configuration.tradeoffs import typical_tradeoffs
from ...envs.errors import MorlaxError, installation
from ...envs.worlds.trees import forwarded
from ...evaluation.figures import map_figure
from ...evaluation.front import Front
from ...evaluation.style import pixels
from ...host.files import replacing, write_file
from ...host.phases import phase
from ...networks.policy import Policy
from ..camera import Area, FollowingCamera, cameras_for
from ..player import Player
from . import panels
from .rendering import Scene, check_size

LONGEST = 3600.0  # simulated seconds of a film
MOST_PICTURES = 100
PORTRAIT = 1.0  # simulated seconds at which a report shows the robot
LINGER = 1.0  # seconds that a film continues after every robot is done
MARK = 9  # pixels from the middle of a sweep's mark to its edge, on a panel of 360 lines
# The H.264 that every browser plays needs even sizes; a GIF looks better with its own palette.
_ENCODERS = {
    ".mp4": (
        *("-f", "mp4", "-codec:v", "libx264", "-crf", "20", "-pix_fmt", "yuv420p"),
        *("-movflags", "+faststart", "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2:color=white"),
    ),
    ".gif": (
        *("-f", "gif", "-vf"),
        "split[a][b];[a]palettegen=max_colors=96[p];[b][p]paletteuse=dither=none",
    ),
}
FASTEST = {".mp4": 30.0, ".gif": 20.0}  # frames per second, at most
UNSEEN = 3  # of 255: a smaller change of a pixel is left out of a GIF, which then compresses better
ENDINGS = tuple(_ENCODERS)


class Film:
    """One robot under each of P trade-offs, all from the same start and seen from one distance.

    With `bodies`, by design parameters, there is a panel for each trade-off of each body. A robot
    that fails is frozen and dimmed, with the returns of its episode. A film ends a second after
    every robot has failed or finished its motion; other robots go on after a time limit. `record`
    describes the arguments.
    """

    endless = False  # whether robots start again after each episode

    def __init__(
        self,
        policy: Policy,
        tradeoffs: Iterable[Sequence[float] | Schedule],
        width: int = 480,
        height: int = 360,
        seed: int = 0,
        bodies: Sequence[Mapping[str, float]] = (),
    ):
        check_size(width, height)
        policies = [policy.for_design(body) for body in bodies] or [policy]
        players = [Player(*pair, seed) for pair in product(policies, tradeoffs)]
        self._takes = [Take(player, width, height) for player in players]
        self._size = width, height
        self.dt = self._takes[0].player.env.dt

    def steps(self, seconds: float) -> int:
        """Convert simulated seconds, from a control step to LONGEST, to control steps."""
        if not self.dt <= seconds <= LONGEST:
            limits = f"at least one control step ({self.dt:g} s) and at most {LONGEST:g} s"
            raise MorlaxError(f"a film must last {limits}, not {seconds:g} s.")
        return round(seconds / self.dt)

    def pace(self, speed: float = 1.0, fastest: float = 30.0) -> tuple[int, float]:
        """Return the control steps per frame, and the frames per second, at most `fastest`."""
        if not 0.01 <= speed <= 100:
            raise MorlaxError(f"the speed must be from 0.01 to 100, not {speed:g}.")
        rate = speed / self.dt
        stride = max(1, math.ceil(rate / fastest - 1e-9))
        return stride, rate / stride

    def frames(self, seconds: float = 5.0, stride: int = 1) -> Iterator[NDArray[np.uint8]]:
        """Render frames (H, W, 3) RGB: all panels, with trade-offs and running returns.

        The first frame shows the start, and `stride` control steps lie between two frames.
        """
        takes, steps = self._takes, self.steps(seconds)
        for take in takes:
            take.reset()
        with self._scenes() as scenes:
            for step in range(0, steps + 1, stride):
                phase("filming", step / steps)
                self._prepare(step / steps)
                for take, _ in product(takes, range(stride if step else 0)):
                    if self.endless and (take.failed or take.player.over):
                        take.reset()
                    if not take.done:
                        take.step()
                farthest = max(take.distance for take in takes)
                pairs = zip(takes, scenes, strict=True)
                robots = [take.panel(scene, farthest) for take, scene in pairs]
                yield self._arranged(robots, step / steps)
                last = max(take.player.steps for take in takes)
                over = all(take.done for take in takes) and not self.endless
                if over and (step - last) * self.dt >= LINGER:
                    return

    def _prepare(self, share: float) -> None:
        """Prepare the steps before the frame at a share of the film."""

    def _arranged(self, robots: list[Image.Image], share: float) -> NDArray[np.uint8]:
        return panels.side_by_side(robots)

    def strip(self, seconds: float = 5.0, pictures: int = 8) -> NDArray[np.uint8]:
        """Render a film strip (H, W, 3) RGB: a row of each trade-off, all on one time scale."""
        if not 2 <= pictures <= MOST_PICTURES:
            raise MorlaxError(f"a row has 2 to {MOST_PICTURES} pictures, not {pictures}.")
        steps, player = self.steps(seconds), self._takes[0].player
        motions = []
        for number, take in enumerate(self._takes):
            phase("filming", number / len(self._takes))
            motions.append(take.motion(steps))
        moments = panels.moments(motions, self.dt, pictures)
        rows = [take.poses(row) for take, row in zip(self._takes, moments, strict=True)]
        aspect, base = self._size[0] / self._size[1], player.env.base
        poses = [data for row in rows for data, *_ in row]
        cameras, drawn = iter(cameras_for(player.model, aspect, poses, base)), []
        with self._scenes() as scenes:
            for take, scene, row in zip(self._takes, scenes, rows, strict=True):
                drawn.append(panels.labeled(take.label(), *self._size))
                for data, time, failed, ghost in row:
                    picture = Image.fromarray(scene.draw(data, next(cameras), ghost))
                    drawn.append(panels.timed(picture, time, failed))
        return panels.side_by_side(drawn, 1 + pictures)

    @contextmanager
    def _scenes(self) -> Iterator[list[Scene]]:
        """Open the scene of each robot; robots of one body share theirs."""
        models = {take.player.policy: take.player.model for take in self._takes}
        with ExitStack() as stack:
            opened = (stack.enter_context(Scene(model, *self._size)) for model in models.values())
            scenes = dict(zip(models, opened, strict=True))
            yield [scenes[take.player.policy] for take in self._takes]


class Take:
    """One robot and its latest picture, frozen once it fails."""

    def __init__(self, player: Player, width: int, height: int):
        self.player = player
        self.note = ""  # before the time
        self.failed = False
        self._frozen: Image.Image | None = None  # its picture since it failed
        # the robot stands right of the table or below it; in a small picture, anywhere
        table = panels.Layout(self._table(), height)
        areas = [Area(0, 0, 1, 1 - table.bottom / height), Area(table.right / width, 0, 1, 1)]
        free = [area for area in areas if min(area.top, 1 - area.left) > 0.5]
        self._camera = FollowingCamera(player.model, width / height, player.env.base, free)

    def reset(self) -> None:
        self.player.reset()
        self._camera.restart(self.player.data)
        self.failed, self._frozen = False, None

    def step(self) -> None:
        self.failed = bool(self.player.step().terminated)
        self._camera.follow(self.player.data, self.player.env.dt)

    @property
    def done(self) -> bool:
        """Whether the robot has failed, or the motion that it follows has ended."""
        return self.failed or (self.player.ghost is not None and self.player.over)

    @property
    def distance(self) -> float:
        """Of the camera; 0 once the robot has failed."""
        return 0.0 if self.failed else self._camera.camera.distance

    def panel(self, scene: Scene, distance: float) -> Image.Image:
        """Draw the robot with its captions, from at least `distance`; once if it has failed."""
        if self._frozen is not None:
            return self._frozen
        self._camera.stand_back(distance)
        player = self.player
        drawn = scene.draw(player.data, self._camera.camera, player.ghost)
        picture = Image.fromarray(drawn)
        clock = f"{self.player.steps * self.player.env.dt:.2f} s"
        if self.failed:
            picture, clock = panels.dimmed(picture), f"failed after {clock}"
        words = filter(None, [*self._body(), self.note, clock])
        picture = panels.captioned(picture, self._table(), ", ".join(words))
        self._frozen = picture if self.failed else None
        return picture

    def motion(self, steps: int) -> NDArray[np.float64]:
        """Run an episode of so many steps, and return the angles of the robot's hinges (T, J)."""
        self.reset()
        states, self._ghosts = [self.player.data.qpos.copy()], [self.player.env.ghost()]
        while self.player.steps < steps and not self.done:
            self.step()
            states.append(self.player.data.qpos.copy())
            self._ghosts.append(self.player.env.ghost())
        self._qpos = np.stack([state for state in states if np.isfinite(state).all()])
        model = self.player.model
        return self._qpos[:, model.jnt_qposadr[model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE]]

    def poses(
        self, steps: Sequence[int]
    ) -> list[tuple[mujoco.MjData, float, bool, mujoco.MjData | None]]:
        """Return the robot at steps of its motion, with seconds, whether it failed, and ghosts."""
        model, dt, poses = self.player.model, self.player.env.dt, []
        for step in steps:
            failed = self.failed and step == len(self._qpos) - 1
            pose = self._ghosts[step]
            ghost = None if pose is None else forwarded(model, pose.numpy())
            poses.append((forwarded(model, self._qpos[step]), step * dt, failed, ghost))
        return poses

    def _body(self) -> list[str]:
        """Return the design parameters that are not the default, such as "thigh 0.4 m"."""
        policy = self.player.policy
        parameters = policy.agent.designs
        design = policy.config.task.design if parameters else {}
        return [
            f"{name.replace('_', ' ')} {value:.3g} {parameters[name].unit}"
            for name, value in design.items()
            if value != parameters[name].default
        ]

    def _table(self) -> list[panels.Row]:
        player, rows = self.player, []
        shares = np.array(player.tradeoff) / sum(player.tradeoff)
        names = [player.env.titles.get(name, name) for name in player.env.objectives]
        for name, share, x in zip(names, shares, player.returns.tolist(), strict=True):
            rows.append((name, f"{share:.2f}", f"{x:,.0f}" if abs(x) >= 100 else f"{x:.1f}"))
        return rows

    def label(self) -> str:
        """Return a line for each weight, or "only NAME" if there is one."""
        player, rows = self.player, self._table()
        weights = [f"{name} {share}" for name, share, _ in rows]
        if player.schedule is not None:
            weights = ["trade-off", "over time"]
        elif np.count_nonzero(player.tradeoff) == 1:
            weights = [f"only {rows[int(np.argmax(player.tradeoff))][0]}"]
        return "\n".join([*self._body(), *weights])


class Sweep(Film):
    """One robot that goes from each objective alone to the next, beside a plot of the front."""

    endless = True

    def __init__(self, policy: Policy, front: Front, width: int, height: int, seed: int = 0):
        self._corners = np.eye(len(policy.objectives))
        super().__init__(policy, self._corners[:1].tolist(), width, height, seed)
        self._front = front
        figure, axes, pair = map_figure(front, width / 100, height / 100)
        figure.set_dpi(100)
        self._map = Image.fromarray(pixels(figure)).resize((width, height))
        self._places = axes.transData.transform(front.returns[:, pair])  # from below

    def _prepare(self, share: float) -> None:
        legs = np.arange(len(self._corners))
        weights = [np.interp(share * legs[-1], legs, column) for column in self._corners]
        self._takes[0].player.tradeoff = weights

    def _arranged(self, robots: list[Image.Image], share: float) -> NDArray[np.uint8]:
        """Mark the policy that is nearest on the front."""
        away = self._front.tradeoffs - self._takes[0].player.tradeoff
        x, y = self._places[np.square(away).sum(1).argmin()]
        picture, size = self._map.copy(), MARK * self._map.height / 360
        box = (x - size, picture.height - y - size, x + size, picture.height - y + size)
        ImageDraw.Draw(picture).ellipse(box, outline=panels.INK, width=max(2, round(size / 3)))
        return panels.side_by_side([*robots, picture])


def record(
    policy: Policy,
    output: Path,
    tradeoffs: Sequence[Sequence[float] | Schedule] = (),
    seconds: float = 5.0,
    speed: float = 1.0,
    width: int = 480,
    height: int = 360,
    pictures: int = 8,
    seed: int = 0,
    special: Callable[[int, int, int], Film] | None = None,
    bodies: Sequence[Mapping[str, float]] = (),
) -> None:
    """Write a film (.mp4, .gif) or a film strip (.png), by the suffix of `output`.

    Args:
        tradeoffs: (P, m), one panel each (empty: the corners and the balanced trade-off).
        seconds: simulated time; a film strip shows the end of it.
        speed: playback speed of a film; 0.5 is slow motion.
        width, height: of a panel, in pixels.
        pictures: number per row of a film strip, evenly spaced over the longest gait cycle or two.
        bodies: design parameters of each body to show, by name, each with every trade-off (empty:
            the body of the policy). Then the default is the balanced trade-off.
        special: makes another film instead, of width, height and seed: a `Sweep`, or a `Growth`.

    Raises:
        MorlaxError: an unusable number, no OpenGL, no ffmpeg, or `output` cannot be written.
    """
    ending = output.suffix.lower()
    if ending not in (*ENDINGS, ".png"):
        raise MorlaxError(f"{output} must end in .mp4 or .gif (a film) or in .png (a film strip).")
    if special is None:
        m = len(policy.objectives)
        shown = tradeoffs or ([[1 / m] * m] if bodies else typical_tradeoffs(m).tolist())
        film = Film(policy, shown, width, height, seed, bodies)
    elif tradeoffs or bodies or ending == ".png":
        raise MorlaxError(
            "--sweep and --training are films, not strips, of one body; a sweep needs no trade-off."
        )
    else:
        film = special(width, height, seed)
    if ending == ".png":
        write_file(output, png(film.strip(seconds, pictures)))
    else:
        stride, fps = film.pace(speed, FASTEST[ending])
        write_video(output, film.frames(seconds, stride), fps)


def strip(policy: Policy, tradeoff: Sequence[float]) -> bytes | None:
    """Return a small film strip of a policy on the CPU as PNG; None if it cannot be drawn here."""
    try:
        return png(Film(policy, [tradeoff], width=240, height=180).strip())
    except MorlaxError:  # no OpenGL, or no MuJoCo robot
        return None


def portrait(policy: Policy) -> bytes | None:
    """Return a picture of the robot under equal weights as PNG; None if it cannot be drawn here."""
    phase("drawing the robot")
    try:
        equal = [1.0] * len(policy.objectives)
        film = Film(deepcopy(policy).cpu(), [equal], width=640, height=400)
        *_, last = film.frames(PORTRAIT, film.steps(PORTRAIT))
        return png(last)
    except MorlaxError:
        return None


def png(picture: NDArray[np.uint8]) -> bytes:
    """Encode a picture (H, W, 3) RGB."""
    file = BytesIO()
    Image.fromarray(picture).save(file, format="PNG")
    return file.getvalue()


def write_video(path: Path, frames: Iterator[NDArray[np.uint8]], fps: float) -> None:
    """Write frames (H, W, 3) RGB of one size as a video; the suffix selects .mp4 or .gif."""
    ffmpeg, ending = find_ffmpeg(), path.suffix.lower()
    rate = str(Fraction(fps).limit_denominator(1000))
    if ending == ".gif":
        frames = _steady(frames)
    with replacing(path) as file:
        first = next(frames)
        height, width, _ = first.shape
        command = [
            *(ffmpeg, "-v", "error", "-y"),
            *("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", rate),
            *("-i", "-", *_ENCODERS[ending], file.name),
        ]
        pipe = subprocess.PIPE
        with subprocess.Popen(command, stdin=pipe, stderr=pipe) as process:
            assert process.stdin is not None
            with suppress(BrokenPipeError):  # ffmpeg failed; its stderr has the reason
                for frame in chain([first], frames):
                    process.stdin.write(frame.tobytes())
            _, message = process.communicate()
        if process.returncode:
            reason = message.decode(errors="replace").strip().splitlines() or ["ffmpeg failed"]
            raise MorlaxError(f"cannot write {path}: {reason[-1].rstrip('.')}.")


def _steady(frames: Iterator[NDArray[np.uint8]]) -> Iterator[NDArray[np.uint8]]:
    """Let pixels keep their color until it changes visibly."""
    yield (shown := next(frames))
    for frame in frames:
        change = np.abs(frame.astype(np.int16) - shown).max(-1, keepdims=True)
        shown = np.where(change <= UNSEEN, shown, frame)
        yield shown


def find_ffmpeg() -> str:
    """Return the path of ffmpeg, which imageio-ffmpeg includes, or raise MorlaxError."""
    # which() is None if IMAGEIO_FFMPEG_EXE is wrong; RuntimeError if the wheel has no ffmpeg
    with suppress(ImportError, RuntimeError):
        from imageio_ffmpeg import get_ffmpeg_exe

        if program := which(get_ffmpeg_exe()):
            return program
    raise MorlaxError(
        f"writing a film needs ffmpeg: {installation('video')}, set IMAGEIO_FFMPEG_EXE to the path "
        "of ffmpeg, or write a film strip with --output FILE.png."
    )
