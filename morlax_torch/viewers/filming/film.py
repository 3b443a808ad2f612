"""A robot under several trade-offs side by side, as video frames or as a film strip."""

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ...envs import MorlaxError
from ...networks.policy import Policy
from ..player import Player
from . import panels
from .rendering import Scene

FASTEST = 30  # frames per second
LONGEST = 3600.0  # simulated seconds of a film
MOST_PICTURES = 100
LINGER = 1.0  # seconds that a film continues after every robot has failed


class Film:
    """One robot under each of P trade-offs, all from the same start.

    A robot that fails is frozen and dimmed, with the returns of its episode. A film ends a second
    after the last robot has failed. The episode length is ignored: robots continue for the whole
    film.

    Args:
        policy: as `morlax_torch.load` returns it.
        tradeoffs: (P, m), one panel each.
        width: of a panel, in pixels.
        height: of a panel, in pixels.
        seed: random seed of the world, the same for every trade-off.

    Raises:
        MorlaxError: a trade-off is invalid, or the task has no MuJoCo robot.
    """

    def __init__(
        self,
        policy: Policy,
        tradeoffs: Iterable[Sequence[float]],
        width: int = 480,
        height: int = 360,
        seed: int = 0,
    ):
        self._takes = [_Take(Player(policy, tradeoff, seed)) for tradeoff in tradeoffs]
        self._size = width, height
        self.dt = self._takes[0].player.env.dt

    def steps(self, seconds: float) -> int:
        """Convert simulated seconds to control steps.

        Raises:
            MorlaxError: `seconds` is shorter than a control step, or longer than LONGEST.
        """
        if not self.dt <= seconds <= LONGEST:
            raise MorlaxError(
                f"a film must last at least one control step ({self.dt:g} s) and at most "
                f"{LONGEST:g} s, not {seconds:g} s."
            )
        return round(seconds / self.dt)

    def pace(self, speed: float = 1.0) -> tuple[int, float]:
        """Return the control steps per frame, and the frames per second, at most 30.

        Args:
            speed: playback speed; 1 is real time.

        Raises:
            MorlaxError: `speed` is not in (0, 100].
        """
        if not 0 < speed <= 100:
            raise MorlaxError(f"the speed must be above 0 and at most 100, not {speed:g}.")
        rate = speed / self.dt
        every = max(1, math.ceil(rate / FASTEST - 1e-9))
        return every, rate / every

    def frames(self, seconds: float = 5.0, every: int = 1) -> Iterator[NDArray[np.uint8]]:
        """Render frames (H, W, 3) RGB: all panels, with trade-offs and running returns.

        The first frame shows the start.

        Args:
            seconds: simulated time.
            every: control steps per frame.

        Raises:
            MorlaxError: an unusable duration or size, or no OpenGL.
        """
        for pictures in self._pictures(range(0, self.steps(seconds) + 1, every)):
            pairs = zip(self._takes, pictures, strict=True)
            yield panels.side_by_side([take.captioned(picture) for take, picture in pairs])

    def strip(self, seconds: float = 5.0, pictures: int = 8) -> NDArray[np.uint8]:
        """Render a film strip (H, W, 3) RGB: a row of pictures for each trade-off.

        Args:
            seconds: simulated time of the last picture; the first shows the start.
            pictures: number per row, evenly spaced in time.

        Raises:
            MorlaxError: an unusable duration, number or size, or no OpenGL.
        """
        if not 2 <= pictures <= MOST_PICTURES:
            raise MorlaxError(
                f"a film strip needs 2 to {MOST_PICTURES} pictures in a row, not {pictures}."
            )
        steps = np.linspace(0, self.steps(seconds), pictures).round().astype(int).tolist()
        columns = list(self._pictures(steps))
        times = [f"{step * self.dt:.2f} s" for step in steps[: len(columns)]]
        labels = ["\n".join(map(" ".join, take.weights())) for take in self._takes]
        return panels.strip(columns, times, labels)

    def _pictures(self, moments: Iterable[int]) -> Iterator[list[Image.Image]]:
        """Render every robot after each number of control steps in `moments`, of a new episode."""
        for take in self._takes:
            take.reset()
        player = self._takes[0].player
        with Scene(player.model, *self._size) as scene:
            for step in moments:
                yield [take.at(step, scene) for take in self._takes]
                last = max(take.player.steps for take in self._takes)
                over = all(take.failed for take in self._takes)
                if over and (step - last) * self.dt >= LINGER:
                    return


class _Take:
    """One robot and its latest picture, frozen once it fails."""

    def __init__(self, player: Player):
        self.player = player
        self.failed = False
        self._last: Image.Image | None = None

    def reset(self) -> None:
        self.player.reset()
        self.failed, self._last = False, None

    def at(self, step: int, scene: Scene) -> Image.Image:
        """Return the picture after `step` control steps; a failed robot is drawn only once."""
        if self.failed and self._last is not None:
            return self._last
        while self.player.steps < step and not self.failed:
            self.failed = bool(self.player.step().terminated)
        picture = Image.fromarray(scene.draw(self.player.data))
        self._last = panels.dimmed(picture) if self.failed else picture
        return self._last

    def captioned(self, picture: Image.Image) -> Image.Image:
        clock = f"{self.player.steps * self.player.env.dt:.2f} s"
        return panels.captioned(
            picture,
            [
                (*weight, f"{value:,.0f}" if abs(value) >= 100 else f"{value:.1f}")
                for weight, value in zip(self.weights(), self.player.returns.tolist(), strict=True)
            ],
            f"failed after {clock}" if self.failed else clock,
        )

    def weights(self) -> list[tuple[str, str]]:
        """Return the name and normalized weight of each objective."""
        shares = self.player.tradeoff / self.player.tradeoff.sum()
        names = self.player.env.objectives
        return [(name, f"{share:.2f}") for name, share in zip(names, shares.tolist(), strict=True)]
