"""Rows of measurements in CSV files, and tables of them in Markdown."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

Row = dict[str, str]
Kind = TypeVar("Kind", bound=NamedTuple)


def read_rows(path: Path) -> list[Row]:
    """Return the rows of a CSV file; none if there is no file."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def read_tuples(kind: type[Kind], path: Path) -> list[Kind]:
    """Return the rows of a CSV file as named tuples of text, numbers and booleans."""
    parsers = {
        name: (lambda text: text == "True") if field is bool else field
        for name, field in kind.__annotations__.items()
    }
    return [kind(**{name: parsers[name](row[name]) for name in row}) for row in read_rows(path)]


def write_rows(path: Path, rows: Sequence[Mapping[str, Any]], columns: Sequence[str] = ()) -> None:
    """Replace a CSV file by rows, whose columns are those of the first row unless given."""
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, columns or [*rows[0]], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def append_rows(path: Path, rows: Sequence[Mapping[str, Any]], columns: Sequence[str] = ()) -> None:
    """Append rows to a CSV file, and create it with a header if it is missing."""
    if not path.exists():
        write_rows(path, rows, columns)
        return
    with path.open("a", newline="") as file:
        csv.DictWriter(file, columns or [*rows[0]], lineterminator="\n").writerows(rows)


def markdown(heads: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    rows = [heads, ["---"] * len(heads), *lines]
    return "".join(f"| {' | '.join(row)} |\n".replace("  ", " ") for row in rows)
