"""Captions and layout of the pictures of a film, and the moments of a gait that they show."""

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from scipy.signal import detrend, find_peaks

COLUMNS = 4  # panels per row, at most
GAP = 4  # pixels between panels
_font = cache(ImageFont.load_default)  # by size in pixels
INK, PALE, PAPER = (32, 38, 46), (105, 113, 123), (255, 255, 255)
Row = tuple[str, str, str]  # name, weight and return of an objective
HEAD: Row = ("", "trade-off", "return")
STILL = 0.01  # rad or m: the standard deviation of a joint that does not take part
ALIKE = 0.5  # correlation of a motion with itself, one cycle later
SLOWEST = 2.0  # s of a cycle
PLAIN = 1.0  # s that are shown of a motion without a cycle


def dimmed(picture: Image.Image) -> Image.Image:
    return Image.blend(picture, Image.new("RGB", picture.size, PALE), 0.45)


class Layout:
    """The table of objectives on a picture; its numbers are in pixels."""

    def __init__(self, rows: Sequence[Row], height: int):
        size = max(11, height // 22)
        self.font, self.small = _font(size), _font(round(0.8 * size))
        self.pad, self.line = size // 2, round(1.35 * size)
        wide = [max(map(self.font.getlength, column)) for column in zip(*rows, strict=True)]
        wide[1] = max(wide[1], self.small.getlength(HEAD[1]))
        wide[2] = max(wide[2], self.font.getlength("00,000"))  # keeps the table width constant
        self.ends = np.cumsum(wide) + size * np.arange(2, 5)  # of the columns
        self.right, self.bottom = float(self.ends[2]), 2 * self.pad + self.line * (1 + len(rows))


def captioned(picture: Image.Image, rows: Sequence[Row], clock: str) -> Image.Image:
    """Return a copy with a table and the time, in words, drawn on it."""
    picture, table = picture.copy(), Layout(rows, picture.height)
    draw, pad = ImageDraw.Draw(picture, "RGBA"), table.pad
    draw.rounded_rectangle((pad, pad, table.right, table.bottom), pad, (*PAPER, 190))
    for number, (name, *words) in enumerate([HEAD, *rows]):
        y = 1.5 * pad + (number + 0.5) * table.line
        look = (INK, table.font) if number else (PALE, table.small)
        draw.text((2 * pad, y), name, *look, anchor="lm")
        for x, text in zip(table.ends[1:] - pad, words, strict=True):
            draw.text((x, y), text, *look, anchor="rm")
    draw.text((picture.width - pad, picture.height - pad), clock, INK, table.font, anchor="rs")
    return picture


def side_by_side(panels: Sequence[Image.Image], most: int = COLUMNS) -> NDArray[np.uint8]:
    """Arrange panels of one size in as few rows as possible: (H, W, 3) RGB."""
    rows = -(-len(panels) // most)
    columns = -(-len(panels) // rows)
    width, height = panels[0].width + GAP, panels[0].height + GAP
    sheet = Image.new("RGB", (columns * width - GAP, rows * height - GAP), PAPER)
    for number, panel in enumerate(panels):
        row, column = divmod(number, columns)
        sheet.paste(panel, (column * width, row * height))
    return np.asarray(sheet)


def labeled(text: str, width: int, height: int) -> Image.Image:
    """Return an empty picture with lines of text at its right."""
    # large, because strips are scaled to page width, but no wider than a panel
    longest = max(map(_font(100).getlength, text.splitlines())) / 100
    size = max(8, min(height // 9, int(0.9 * width / longest)))
    picture, middle = Image.new("RGB", (width, height), PAPER), (width - size / 3, height / 2)
    ImageDraw.Draw(picture).multiline_text(middle, text, INK, _font(size), "rm", align="right")
    return picture


def timed(picture: Image.Image, seconds: float, failed: bool) -> Image.Image:
    """Return a copy with its time, dimmed if the robot has failed then."""
    picture, size = picture.copy(), max(11, min(picture.height, picture.width) // 9)
    picture, text = (dimmed(picture), "failed at ") if failed else (picture, "")
    corner = picture.width - size / 3, picture.height - size / 3
    ImageDraw.Draw(picture).text(corner, f"{text}{seconds:.2f} s", INK, _font(size), anchor="rs")
    return picture


def cycle(positions: NDArray[np.float64], dt: float) -> int | None:
    """Return the steps of a gait cycle, or None if the motion does not repeat.

    The cycle is the first peak of the motion's autocorrelation that is nearly as high as the
    highest. Positions of joints are (T, J); a step takes `dt` seconds.
    """
    moving = positions[:, positions.std(0) > STILL]
    steps = len(moving)
    if steps < 4 or not moving.size:
        return None
    motion = detrend(moving, axis=0)
    powers = np.square(motion).sum(1)
    alike = np.ones(1 + min(steps // 2, round(SLOWEST / dt)))
    for lag in range(1, len(alike)):
        both = np.sqrt(powers[lag:].sum() * powers[:-lag].sum())
        alike[lag] = (motion[lag:] * motion[:-lag]).sum() / max(both, 1e-12)
    peaks, _ = find_peaks(alike, ALIKE)
    apart = peaks[np.minimum.accumulate(alike)[peaks] < 0.5 * alike[peaks]]
    high = apart[alike[apart] > 0.85 * alike[apart].max(initial=0.0)]
    return int(high[0]) if len(high) else None


def moments(motions: Sequence[NDArray[np.float64]], dt: float, pictures: int) -> list[list[int]]:
    """Return the control steps of evenly spaced pictures of each motion, all on one time scale.

    They show the longest of the last gait cycles, whose first and last picture show the same phase;
    one of fewer steps than pictures twice, and motions without a cycle for one second. A motion
    that ends before repeats its last step. For positions and dt see `cycle`.
    """
    cycles = [cycle(positions[len(positions) // 2 :], dt) or 0 for positions in motions]
    span = max(cycles) or round(PLAIN / dt)
    if span < pictures - 1:
        span *= 2
    span = min(span, max(map(len, motions)) - 1)
    steps = np.linspace(0, span, pictures).round().astype(int)
    lasts = [len(positions) - 1 for positions in motions]
    return [np.minimum(max(0, last - span) + steps, last).tolist() for last in lasts]
