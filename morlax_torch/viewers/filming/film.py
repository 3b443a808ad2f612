"""A robot under several trade-offs side by side, as video frames or as a film strip."""

import math
from collections.abc import Iterable, Iterator, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ...envs import MorlaxError
from ...networks.policy import Policy
from ...phases import phase
from ..camera import WHOLE, Area, FollowingCamera, cameras_for
from ..player import Player
from . import panels
from .panels import joint_positions, moments
from .rendering import Scene, check_size

LONGEST = 3600.0  # simulated seconds of a film
MOST_PICTURES = 100
LINGER = 1.0  # seconds that a film continues after every robot has failed


class Film:
    """One robot under each of P trade-offs, all from the same start.

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
    ):
        check_size(width, height)
        players = [Player(policy, tradeoff, seed) for tradeoff in tradeoffs]
        self._takes = [_Take(player, width, height) for player in players]
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
        steps, rows = self.steps(seconds), []
        with Scene(self._takes[0].player.model, *self._size) as scene:
            for number, take in enumerate(self._takes):
                phase("filming", number / len(self._takes))
                rows.append(take.row(steps, pictures, scene))
        labels = ["\n".join(map(" ".join, take.weights())) for take in self._takes]
        return panels.strip(rows, labels)

    def _pictures(self, moments: Iterable[int]) -> Iterator[list[Image.Image]]:
        """Render every robot after each number of control steps in `moments`, of a new episode."""
        for take in self._takes:
            take.reset()
        with Scene(self._takes[0].player.model, *self._size) as scene:
            for step in moments:
                yield [take.at(step, scene) for take in self._takes]
                last = max(take.player.steps for take in self._takes)
                over = all(take.failed for take in self._takes)
                if over and (step - last) * self.dt >= LINGER:
                    return


class _Take:
    """One robot and its latest picture, frozen once it fails."""

    def __init__(self, player: Player, width: int, height: int):
        self.player, self._size = player, (width, height)
        self._camera = FollowingCamera(player.model, width / height, self._free())
        self.failed = False
        self._last: Image.Image | None = None

    def _free(self) -> list[Area]:
        """Return the parts of a picture right of the table and below it; of a small one, all."""
        width, height = self._size
        right, bottom = panels.table_corner(self._table(), height)
        below, beside = Area(0, 0, 1, 1 - bottom / height), Area(right / width, 0, 1, 1)
        return [area for area in (below, beside) if min(area.top, 1 - area.left) > 0.5] or [WHOLE]

    def reset(self) -> None:
        self.player.reset()
        self._camera.restart(self.player.data)
        self.failed, self._last = False, None

    def step(self) -> None:
        self.failed = bool(self.player.step().terminated)
        self._camera.follow(self.player.data, self.player.env.dt)

    def at(self, step: int, scene: Scene) -> Image.Image:
        """Return the picture after `step` control steps; a failed robot is drawn only once."""
        if self.failed and self._last is not None:
            return self._last
        while self.player.steps < step and not self.failed:
            self.step()
        picture = Image.fromarray(scene.draw(self.player.data, self._camera.camera))
        self._last = panels.dimmed(picture) if self.failed else picture
        return self._last

    def row(self, steps: int, pictures: int, scene: Scene) -> list[Image.Image]:
        """Return pictures of the last gait cycle of an episode of at most `steps`, with times."""
        self.reset()
        states = [self._state()]
        while self.player.steps < steps and not self.failed:
            self.step()
            states.append(self._state())
        states = [state for state in states if np.isfinite(state).all()]
        model, dt = self.player.model, self.player.env.dt
        shown = moments(joint_positions(model, np.stack(states)), dt, pictures)
        poses = [_posed(model, states[step]) for step in shown]
        cameras, row = cameras_for(model, self._size[0] / self._size[1], poses), []
        for step, pose, camera in zip(shown, poses, cameras, strict=True):
            picture = Image.fromarray(scene.draw(pose, camera))
            over = self.failed and step == len(states) - 1
            row.append(panels.timed(panels.dimmed(picture) if over else picture, step * dt))
        return row

    def _state(self) -> NDArray[np.float64]:
        return self.player.data.qpos.copy()

    def captioned(self, picture: Image.Image) -> Image.Image:
        clock = f"{self.player.steps * self.player.env.dt:.2f} s"
        return panels.captioned(
            picture, self._table(), f"failed after {clock}" if self.failed else clock
        )

    def _table(self) -> list[panels.Row]:
        return [
            (*weight, f"{value:,.0f}" if abs(value) >= 100 else f"{value:.1f}")
            for weight, value in zip(self.weights(), self.player.returns.tolist(), strict=True)
        ]

    def weights(self) -> list[tuple[str, str]]:
        shares = self.player.tradeoff / self.player.tradeoff.sum()
        names = self.player.env.objectives
        return [(name, f"{share:.2f}") for name, share in zip(names, shares.tolist(), strict=True)]


def _posed(model: mujoco.MjModel, qpos: NDArray[np.float64]) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    return data
