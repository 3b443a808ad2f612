"""Write the page: a folder for any static web server."""

import gzip
import json
import os
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from ...exports.formats import onnxruntime
from ...host.files import making
from ...host.phases import within
from .. import libraries
from ..page_files import page_files
from .robot import START, write_robot

TITLE = "TITLE"  # in index.html


def write_page(runs: Sequence[str], folder: Path, device: str | None = None) -> dict[str, int]:
    """Write a page on which policies act in a browser; return the size of each file, by its path.

    The folder must be new or empty, and is complete or not there at all. `device` evaluates the
    front of a run that has none.

    Raises:
        MorlaxError: a run's task cannot run in a browser, a library cannot be downloaded, the extra
            onnx is missing, or `folder` is in use or cannot be written.
    """
    folder = Path(os.path.abspath(folder))
    with making(folder) as draft:
        _write(runs, draft, device)
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.stat().st_size for path in files}


def _write(runs: Sequence[str], folder: Path, device: str | None) -> None:
    onnxruntime()  # fails at once without the extra
    (folder / "libraries").mkdir()
    for name, data in libraries.files().items():
        (folder / "libraries" / name).write_bytes(data)
    known: list[dict[str, Any]] = []
    for index, run in enumerate(runs):
        place = f"runs/{index}"
        with within(Path(run).name):
            known.append({"folder": place, **write_robot(run, folder / place, device)})
    _number(known)
    shared = sum(_compress(file) for file in (folder / "libraries").glob("*.wasm"))
    for run in known:
        files = list((folder / run["folder"]).iterdir())
        sizes = {file.name: _compress(file) for file in files}
        del sizes[START]  # the page counts from when it shows this file
        run |= {"bytes": sum(sizes.values()), "shared": shared}
    (folder / "runs.json").write_text(json.dumps(known))
    titles = ", ".join(run["title"] for run in known)
    for path, data in page_files().items():
        if path == "index.html":
            data = data.replace(TITLE.encode(), escape(titles).encode())
        (folder / path).parent.mkdir(exist_ok=True)
        (folder / path).write_bytes(data)


def _compress(file: Path) -> int:
    """Compress a file in place; returns its new size.

    The page decompresses it, because many web servers send files as they are. Servers that know
    the usual endings of compressed files would decompress them a second time.
    """
    packed = file.with_name(f"{file.name}.packed")
    packed.write_bytes(gzip.compress(file.read_bytes()))
    file.unlink()
    return packed.stat().st_size


def _number(runs: list[dict[str, Any]]) -> None:
    """Tell runs of one task apart in their titles."""
    counts: dict[str, int] = {}
    for run in runs:
        name = run["title"]
        counts[name] = counts.get(name, 0) + 1
        if counts[name] > 1:
            run["title"] = f"{name} {counts[name]}"
