"""A robot under several trade-offs side by side, as video frames or as a film strip."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ...envs import MorlaxError
from ...host.phases import phase
from ...networks.policy import Policy
from ..camera import WHOLE, Area, FollowingCamera, cameras_for
from ..player import Player
from . import panels
from .panels import joint_positions, moments
from .rendering import Scene, check_size

LONGEST = 3600.0  # simulated seconds of a film
MOST_PICTURES = 100
LINGER = 1.0  # seconds that a film continues after every robot has failed


class Film:
    """One robot under each of P trade-offs, all from the same start and seen from one distance.

    With `bodies`, by design parameters, there is a panel for each trade-off of each body.

    A robot that fails is frozen and dimmed, with the returns of its episode. A film ends a second
    after the last robot has failed. The episode length is ignored: robots continue for the whole
    film. `record` describes the arguments.

    Raises:
        MorlaxError: a trade-off or the size is invalid, or the task has no MuJoCo robot.
    """

    def __init__(
        self,
        policy: Policy,
        tradeoffs: Iterable[Sequence[float]],
        width: int = 480,
        height: int = 360,
        seed: int = 0,
        bodies: Sequence[Mapping[str, float]] = (),
    ):
        check_size(width, height)
        policies, shown = [policy.for_design(body) for body in bodies] or [policy], list(tradeoffs)
        players = [Player(each, tradeoff, seed) for each in policies for tradeoff in shown]
        self._takes = [Take(player, width, height) for player in players]
        self._size = width, height
        self.dt = self._takes[0].player.env.dt

    def steps(self, seconds: float) -> int:
        """Convert simulated seconds, from a control step to LONGEST, to control steps."""
        if not self.dt <= seconds <= LONGEST:
            raise MorlaxError(
                f"a film must last at least one control step ({self.dt:g} s) and at most "
                f"{LONGEST:g} s, not {seconds:g} s."
            )
        return round(seconds / self.dt)

    def pace(self, speed: float = 1.0, fastest: float = 30.0) -> tuple[int, float]:
        """Return the control steps per frame, and the frames per second, at most `fastest`.

        The playback speed is in (0, 100]; 1 is real time.
        """
        if not 0 < speed <= 100:
            raise MorlaxError(f"the speed must be above 0 and at most 100, not {speed:g}.")
        rate = speed / self.dt
        every = max(1, math.ceil(rate / fastest - 1e-9))
        return every, rate / every

    def frames(self, seconds: float = 5.0, every: int = 1) -> Iterator[NDArray[np.uint8]]:
        """Render frames (H, W, 3) RGB: all panels, with trade-offs and running returns.

        The first frame shows the start, and `every` control steps lie between two frames.

        Raises:
            MorlaxError: an unusable duration or size, or no OpenGL.
        """
        for pictures in self._pictures(range(0, self.steps(seconds) + 1, every)):
            pairs = zip(self._takes, pictures, strict=True)
            yield panels.side_by_side([take.captioned(picture) for take, picture in pairs])

    def strip(self, seconds: float = 5.0, pictures: int = 8) -> NDArray[np.uint8]:
        """Render a film strip (H, W, 3) RGB: a row of pictures for each trade-off.

        A row shows the last gait cycle of the simulated time, or the last two if the cycle has
        fewer control steps than pictures.

        Raises:
            MorlaxError: an unusable duration, number or size, or no OpenGL.
        """
        if not 2 <= pictures <= MOST_PICTURES:
            raise MorlaxError(
                f"a film strip needs 2 to {MOST_PICTURES} pictures in a row, not {pictures}."
            )
        steps, player = self.steps(seconds), self._takes[0].player
        rows = []
        for number, take in enumerate(self._takes):
            phase("filming", number / len(self._takes))
            rows.append(take.poses(steps, pictures))
        poses = [pose for row in rows for pose in row]
        aspect, data = self._size[0] / self._size[1], [pose.data for pose in poses]
        cameras = cameras_for(player.model, aspect, data, player.env.base)
        with self._scenes() as scenes:
            ordered = [scene for scene, row in zip(scenes, rows, strict=True) for _ in row]
            shown = [pose.drawn(*how) for pose, *how in zip(poses, ordered, cameras, strict=True)]
        together = [shown[i : i + pictures] for i in range(0, len(shown), pictures)]
        return panels.strip(together, [take.label() for take in self._takes])

    def _pictures(self, moments: Iterable[int]) -> Iterator[list[Image.Image]]:
        """Render every robot after each number of control steps in `moments`, of a new episode."""
        for take in self._takes:
            take.reset()
        with self._scenes() as scenes:
            for step in moments:
                for take in self._takes:
                    take.move_to(step)
                farthest = max(take.distance for take in self._takes)
                pairs = zip(self._takes, scenes, strict=True)
                yield [take.picture(scene, farthest) for take, scene in pairs]
                last = max(take.player.steps for take in self._takes)
                over = all(take.failed for take in self._takes)
                if over and (step - last) * self.dt >= LINGER:
                    return

    @contextmanager
    def _scenes(self) -> Iterator[list[Scene]]:
        """Open the scene of each robot; robots of one body share theirs."""
        with ExitStack() as stack:
            found: dict[Policy, Scene] = {}
            for player in (take.player for take in self._takes):
                if player.policy not in found:
                    scene = Scene(player.model, *self._size)
                    found[player.policy] = stack.enter_context(scene)
            yield [found[take.player.policy] for take in self._takes]


class _Pose(NamedTuple):
    """A moment of a film strip."""

    data: mujoco.MjData
    seconds: float
    failed: bool

    def drawn(self, scene: Scene, camera: mujoco.MjvCamera) -> Image.Image:
        picture = Image.fromarray(scene.draw(self.data, camera))
        return panels.timed(panels.dimmed(picture) if self.failed else picture, self.seconds)


class Take:
    """One robot and its latest picture, frozen once it fails."""

    def __init__(self, player: Player, width: int, height: int):
        self.player, self._size = player, (width, height)
        areas = self._free()
        self._camera = FollowingCamera(player.model, width / height, areas, player.env.base)
        self.failed = False
        self._frozen: Image.Image | None = None  # its picture since it failed

    def _free(self) -> list[Area]:
        """Return the parts of a picture right of the table and below it; of a small one, all."""
        width, height = self._size
        right, bottom = panels.table_corner(self._table(), height)
        below, beside = Area(0, 0, 1, 1 - bottom / height), Area(right / width, 0, 1, 1)
        return [area for area in (below, beside) if min(area.top, 1 - area.left) > 0.5] or [WHOLE]

    def reset(self) -> None:
        self.player.reset()
        self._camera.restart(self.player.data)
        self.failed, self._frozen = False, None

    def step(self) -> None:
        self.failed = bool(self.player.step().terminated)
        self._camera.follow(self.player.data, self.player.env.dt)

    @property
    def distance(self) -> float:
        """Of the camera; 0 once the robot has failed."""
        return 0.0 if self.failed else self._camera.camera.distance

    def move_to(self, step: int) -> None:
        """Take the control steps up to number `step`, unless the robot fails before."""
        while self.player.steps < step and not self.failed:
            self.step()

    def picture(self, scene: Scene, distance: float) -> Image.Image:
        """Draw the robot from at least `distance`; a failed robot is drawn only once."""
        if self._frozen is not None:
            return self._frozen
        self._camera.stand_back(distance)
        picture = Image.fromarray(scene.draw(self.player.data, self._camera.camera))
        if self.failed:
            picture = self._frozen = panels.dimmed(picture)
        return picture

    def poses(self, steps: int, pictures: int) -> list[_Pose]:
        """Return moments of the last gait cycle of an episode of at most `steps`."""
        self.reset()
        states = [self._state()]
        while self.player.steps < steps and not self.failed:
            self.step()
            states.append(self._state())
        states = [state for state in states if np.isfinite(state).all()]
        model, dt = self.player.model, self.player.env.dt
        last = len(states) - 1
        return [
            _Pose(_posed(model, states[step]), step * dt, self.failed and step == last)
            for step in moments(joint_positions(model, np.stack(states)), dt, pictures)
        ]

    def _state(self) -> NDArray[np.float64]:
        return self.player.data.qpos.copy()

    def captioned(self, picture: Image.Image) -> Image.Image:
        clock = f"{self.player.steps * self.player.env.dt:.2f} s"
        clock = f"failed after {clock}" if self.failed else clock
        return panels.captioned(picture, self._table(), ", ".join([*self._body(), clock]))

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
        return [
            (*weight, f"{value:,.0f}" if abs(value) >= 100 else f"{value:.1f}")
            for weight, value in zip(self.weights(), self.player.returns.tolist(), strict=True)
        ]

    def label(self) -> str:
        """Return a line for each weight, or "only NAME" if there is one."""
        weights = self.weights()
        alone = [f"only {name}" for name, share in weights if share == "1.00"]
        return "\n".join([*self._body(), "".join(alone) or "\n".join(map(" ".join, weights))])

    def weights(self) -> list[tuple[str, str]]:
        shares = self.player.tradeoff / self.player.tradeoff.sum()
        names = self.player.env.objectives
        return [(name, f"{share:.2f}") for name, share in zip(names, shares.tolist(), strict=True)]


def _posed(model: mujoco.MjModel, qpos: NDArray[np.float64]) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    return data
