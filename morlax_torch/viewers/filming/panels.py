"""Captions and layout of the pictures of a film."""

import math
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

COLUMNS = 4  # panels per row, at most
GAP = 4  # pixels between panels
INK, PALE, PAPER = (32, 38, 46), (105, 113, 123), (255, 255, 255)


def dimmed(picture: Image.Image) -> Image.Image:
    """Return a dimmed copy, for an episode that is over."""
    return Image.blend(picture, Image.new("RGB", picture.size, PALE), 0.45)


def captioned(
    picture: Image.Image, rows: Sequence[tuple[str, str, str]], clock: str
) -> Image.Image:
    """Return a copy with a table and the time drawn on it.

    Args:
        picture: of one robot.
        rows: name, weight and return of each objective.
        clock: the time, in words.
    """
    picture = picture.copy()
    size = max(11, picture.height // 22)
    pad, line, font = size // 2, round(1.35 * size), _font(size)
    wide = [max(map(font.getlength, column)) for column in zip(*rows, strict=True)]
    head = ("", "trade-off", "return")
    small = _font(round(0.8 * size))
    wide[1] = max(wide[1], small.getlength(head[1]))
    wide[2] = max(wide[2], font.getlength("00,000"))  # keeps the table width constant
    right = np.cumsum(wide) + size * np.arange(2, 5)
    draw = ImageDraw.Draw(picture, "RGBA")
    table = (pad, pad, float(right[2]), 2 * pad + line * (1 + len(rows)))
    draw.rounded_rectangle(table, radius=pad, fill=(*PAPER, 190))
    for number, row in enumerate([head, *rows]):
        y = 1.5 * pad + (number + 0.5) * line
        look = (INK, font) if number else (PALE, small)
        draw.text((2 * pad, y), row[0], *look, anchor="lm")
        for x, words in zip(right[1:] - pad, row[1:], strict=True):
            draw.text((x, y), words, *look, anchor="rm")
    draw.text((picture.width - pad, picture.height - pad), clock, INK, font, anchor="rs")
    return picture


def side_by_side(panels: Sequence[Image.Image]) -> NDArray[np.uint8]:
    """Arrange panels of one size in as few rows as possible: (H, W, 3) RGB."""
    rows = -(-len(panels) // COLUMNS)
    columns = -(-len(panels) // rows)
    width, height = panels[0].width + GAP, panels[0].height + GAP
    sheet = Image.new("RGB", (columns * width - GAP, rows * height - GAP), PAPER)
    for number, panel in enumerate(panels):
        row, column = divmod(number, columns)
        sheet.paste(panel, (column * width, row * height))
    return np.asarray(sheet)


def strip(
    columns: Sequence[Sequence[Image.Image]], times: Sequence[str], labels: Sequence[str]
) -> NDArray[np.uint8]:
    """Arrange pictures in a table: (H, W, 3) RGB.

    Args:
        columns: pictures of one size; each column has one per row.
        times: a heading for each column.
        labels: a label for each row, of one or more lines.
    """
    panel = columns[0][0]
    size = max(11, panel.height // 9)  # readable when the strip is scaled to page width
    font, width, height = _font(size), panel.width + GAP, panel.height + GAP
    lines = [line for label in labels for line in label.splitlines()]
    left, top = math.ceil(max(map(font.getlength, lines))) + size, round(1.5 * size)
    extent = left + len(columns) * width - GAP, top + len(labels) * height - GAP
    sheet = Image.new("RGB", extent, PAPER)
    draw = ImageDraw.Draw(sheet)
    for x, (column, time) in enumerate(zip(columns, times, strict=True)):
        draw.text((left + (x + 0.5) * width, top / 2), time, INK, font, anchor="mm")
        for y, picture in enumerate(column):
            sheet.paste(picture, (left + x * width, top + y * height))
    for y, label in enumerate(labels):
        place = left - size / 2, top + (y + 0.5) * height
        draw.multiline_text(place, label, INK, font, "rm", align="right")
    return np.asarray(sheet)


@cache
def _font(size: int) -> ImageFont.FreeTypeFont:
    folder = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    return ImageFont.truetype(str(folder / "DejaVuSans.ttf"), size)
