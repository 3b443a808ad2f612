"""The files of the page, and its JavaScript libraries: fixed versions from npm, kept in a cache."""

import base64
import hashlib
import http.client
import io
import os
import tarfile
import urllib.error
import urllib.request
from pathlib import Path
from typing import NamedTuple

from ..envs import MorlaxError
from ..host.files import make_folder, write_file
from ..host.phases import phase

REGISTRY = "https://registry.npmjs.org"
PATIENCE = 60  # s without an answer
HERE = Path(__file__).parent


class Library(NamedTuple):
    package: str
    version: str
    sha512: str  # of the archive, in base64
    files: dict[str, str]  # path in the archive -> name in the page's folder
    license: str  # its path in the archive, or our copy of the text if the archive has none

    @property
    def archive(self) -> str:
        return f"{self.package.split('/')[-1]}-{self.version}.tgz"

    @property
    def address(self) -> str:
        return f"{REGISTRY}/{self.package}/-/{self.archive}"


LIBRARIES = (
    Library(
        "@mujoco/mujoco",
        "3.14.0",
        "WPUYidu4Fx8+uM4hQv80SOA0ifpWGrsNJguKs8JBV8SCTxjKQ2/rqsh880nUH0/Vwa8vuefghvCQkkoed3bkUg==",
        {"mujoco.js": "mujoco.js", "mujoco.wasm": "mujoco.wasm"},
        "Apache-2.0.txt",
    ),
    Library(
        "three",
        "0.185.1",  # later archives have no minified files, which are a third as large
        "5aojFCXKwnjBRZvUnt3WFfEcvUJgkN5LlijRFN95hMy8WVkG4I0QNcJE+OuWvuJ0bOdStrbfXn0pkd6/QyiAlg==",
        {
            "build/three.module.min.js": "three.module.min.js",
            "build/three.core.min.js": "three.core.min.js",
            "examples/jsm/controls/OrbitControls.js": "OrbitControls.js",
        },
        "LICENSE",
    ),
    Library(
        "onnxruntime-web",
        "1.30.0",
        "q0y+JrrtukXSzsBWEMccVfqX25LRmosXHF+CaRJmg8pZClzcV7svNc4rKY3jL02Vb7QmRMDs1SigqR4CXAfKYQ==",
        {
            "dist/ort.wasm.bundle.min.mjs": "ort.js",
            "dist/ort-wasm-simd-threaded.wasm": "ort.wasm",
        },
        "MIT.txt",
    ),
)


def page_files() -> dict[str, bytes]:
    """Return the contents of the page's own files by path, such as "stage/stage.js"."""
    page = HERE / "page"
    paths = [path for path in page.rglob("*") if path.is_file()]
    return {path.relative_to(page).as_posix(): path.read_bytes() for path in paths}


def files(*packages: str) -> dict[str, bytes]:
    """Return the files of libraries, or of all, by name, and their licenses.

    Raises MorlaxError if a library is neither in the cache nor can it be downloaded.
    """
    contents: dict[str, bytes] = {}
    for library in LIBRARIES:
        if packages and library.package not in packages:
            continue
        text, wanted = HERE / "licenses" / library.license, dict(library.files)
        name = f"{library.package.split('/')[-1]}.LICENSE.txt"
        if text.exists():
            contents[name] = text.read_bytes()
        else:
            wanted[library.license] = name
        with tarfile.open(fileobj=io.BytesIO(_archive(library)), mode="r:gz") as archive:
            for path, name in wanted.items():
                file = archive.extractfile(f"package/{path}")
                assert file is not None, path
                contents[name] = file.read()
    return contents


def cache() -> Path:
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(home) / "morlax_torch" / "web"


def _archive(library: Library) -> bytes:
    kept = cache() / library.archive
    if kept.is_file() and _is_intact(data := kept.read_bytes(), library):
        return data
    phase(f"downloading {library.archive}")
    try:
        with urllib.request.urlopen(library.address, timeout=PATIENCE) as response:
            data = response.read()
    except (OSError, ValueError, http.client.HTTPException) as error:
        reason = getattr(error, "reason", None) or error
        raise MorlaxError(
            f"cannot download {library.address} ({reason}): connect to the internet once, or copy "
            f"this file to {kept}."
        ) from None
    if not _is_intact(data, library):
        raise MorlaxError(
            f"{library.address} has another SHA-512 than expected: it was changed on the way, try "
            "another network."
        )
    make_folder(kept.parent)
    write_file(kept, data)
    return data


def _is_intact(data: bytes, library: Library) -> bool:
    return base64.b64encode(hashlib.sha512(data).digest()).decode() == library.sha512
