"""A film of one robot whose trade-off moves along the front, beside a plot of the front."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from ...evaluation.figures.front import map_figure
from ...evaluation.figures.style import pixels
from ...evaluation.front import Front
from ...networks.policy import Policy
from . import panels
from .film import Film, Take
from .rendering import Scene

MARK = 9  # pixels from the middle of the mark to its edge, on a panel of 360 lines


class Sweep(Film):
    """One robot that goes from each objective alone to the next, and starts anew if it fails.

    A ring marks the evaluated trade-off that is nearest to its own. For the arguments and errors
    see `Film`.
    """

    def __init__(
        self, policy: Policy, front: Front, width: int = 480, height: int = 360, seed: int = 0
    ):
        corners = np.eye(len(policy.objectives))
        super().__init__(policy, corners[:1].tolist(), width, height, seed)
        self._front, self._corners = front, corners
        figure, axes, pair = map_figure(front, width / 100, height / 100)
        figure.set_dpi(100)
        self._map = Image.fromarray(pixels(figure)).resize((width, height))
        self._places = axes.transData.transform(front.returns[:, pair])  # from below

    def frames(self, seconds: float = 5.0, every: int = 1) -> Iterator[NDArray[np.uint8]]:
        take: Take = self._takes[0]
        take.reset()
        steps = self.steps(seconds)
        with Scene(take.player.model, *self._size) as scene:
            for step in range(0, steps + 1, every):
                tradeoff = self._at(step / steps)
                take.player.tradeoff = tradeoff.tolist()
                for _ in range(every if step else 0):
                    if take.failed:
                        take.reset()
                    take.step()
                picture = take.captioned(take.picture(scene, 0.0))
                yield panels.side_by_side([picture, self._marked(tradeoff)])

    def _at(self, share: float) -> NDArray[np.float64]:
        """Return the trade-off (m,) after a share of the film."""
        passed = share * (len(self._corners) - 1)
        leg = min(int(passed), len(self._corners) - 2)
        start, end = self._corners[leg : leg + 2]
        return start + (passed - leg) * (end - start)

    def _marked(self, tradeoff: NDArray[np.float64]) -> Image.Image:
        nearest = np.square(self._front.tradeoffs - tradeoff).sum(1).argmin()
        x, y = self._places[nearest]
        picture, size = self._map.copy(), MARK * self._map.height / 360
        box = (x - size, picture.height - y - size, x + size, picture.height - y + size)
        ImageDraw.Draw(picture).ellipse(box, outline=panels.INK, width=max(2, round(size / 3)))
        return picture
