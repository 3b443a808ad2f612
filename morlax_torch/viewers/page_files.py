"""The files of the page, without the libraries that it needs."""

from collections.abc import Iterator
from importlib import resources
from importlib.resources.abc import Traversable


def page_files() -> dict[str, bytes]:
    """Return the contents of the page's files by path, such as "stage/stage.js"."""
    return dict(_within(resources.files(str(__package__)) / "page", ""))


def _within(folder: Traversable, path: str) -> Iterator[tuple[str, bytes]]:
    for file in folder.iterdir():
        if file.is_dir():
            yield from _within(file, f"{path}{file.name}/")
        else:
            yield path + file.name, file.read_bytes()
