"""Named trade-offs of a run, in a file that people can edit: "calm: [0.2, 0.8]"."""

from collections.abc import Sequence
from pathlib import Path

import yaml

from ..configuration.tradeoffs import parse_tradeoff
from ..envs import MorlaxError
from ..envs.errors import unknown
from ..envs.worlds.options import PLAIN_NAME
from ..host.files import AnyPath, read, write_file
from .loading import find_run, own_folder

FILE = "bookmarks.yaml"
SIGN = "@"  # before the name of a bookmark, in the place of a trade-off


def check_bookmark(run: AnyPath, name: str) -> Path:
    """Return the file that keeps a bookmark.

    Raises:
        MorlaxError: the name is unusual, or there is no such run, or it is a shipped policy.
    """
    if not PLAIN_NAME.fullmatch(name):
        raise MorlaxError(
            f"{name!r} cannot name a bookmark: use at most 40 letters (A-Z, a-z), digits, spaces, "
            "_ and -, and start with a letter or digit."
        )
    folder = own_folder(run)
    if folder is None:
        raise MorlaxError(
            f"shipped policies keep no bookmarks: copy it first, by pack {run} my-{run}."
        )
    return folder / FILE


def bookmark(run: AnyPath, name: str, tradeoff: Sequence[float]) -> Path:
    """Store a trade-off (m,) under a name, also in the place of an earlier one; returns the file.

    Raises:
        MorlaxError: see `check_bookmark`.
    """
    file = check_bookmark(run, name)
    known = {**bookmarks(run), name: [float(weight) for weight in tradeoff]}
    write_file(file, yaml.safe_dump(known, default_flow_style=None, sort_keys=False))
    return file


def bookmarks(run: AnyPath) -> dict[str, list[float]]:
    """Return the trade-offs of a run by name.

    Raises:
        MorlaxError: there is no such run, or the file is damaged.
    """
    file = find_run(run) / FILE
    if not file.is_file():
        return {}
    try:
        found = yaml.safe_load(read(file, "bookmarks"))
        return {str(name): [float(weight) for weight in w] for name, w in found.items()}
    except (yaml.YAMLError, AttributeError, TypeError, ValueError):
        raise MorlaxError(
            f"{file} is damaged: each of its lines is a name and weights, such as calm: [0.2, 0.8]."
        ) from None


def tradeoff_of(text: str, run: AnyPath, objectives: Sequence[str]) -> tuple[float, ...]:
    """Parse a trade-off such as "0.8,0.2", or "@NAME" of a bookmark of the run.

    Raises:
        MorlaxError: there is no such bookmark, or the trade-off does not fit the objectives.
    """
    if not text.startswith(SIGN):
        return parse_tradeoff(text, objectives)
    known, name = bookmarks(run), text.removeprefix(SIGN)
    if name not in known:
        raise unknown(f"bookmark of {run}", name, known)
    return parse_tradeoff(",".join(map(repr, known[name])), objectives)
