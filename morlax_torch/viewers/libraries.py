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
    license: str | None = None  # our copy of the text, if the archive has none


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
            "LICENSE": "three.LICENSE.txt",
        },
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


def page_files(*packages: str) -> dict[str, bytes]:
    """Return the files of the page by path, such as "stage/stage.js", and those of libraries."""
    page = HERE / "page"
    paths = [path for path in page.rglob("*") if path.is_file()]
    contents = {path.relative_to(page).as_posix(): path.read_bytes() for path in paths}
    return contents | {f"libraries/{name}": data for name, data in files(*packages).items()}


def files(*packages: str) -> dict[str, bytes]:
    """Return the files of libraries, or of all, by name, and their licenses.

    Raises MorlaxError if a library is neither in the cache nor can it be downloaded.
    """
    contents: dict[str, bytes] = {}
    for library in LIBRARIES:
        if packages and library.package not in packages:
            continue
        if library.license is not None:
            name = f"{library.package.split('/')[-1]}.LICENSE.txt"
            contents[name] = (HERE / "licenses" / library.license).read_bytes()
        with tarfile.open(fileobj=io.BytesIO(_archive(library)), mode="r:gz") as archive:
            for path, name in library.files.items():
                file = archive.extractfile(f"package/{path}")
                assert file is not None, path
                contents[name] = file.read()
    return contents


def cache() -> Path:
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(home) / "morlax_torch" / "web"


def _archive(library: Library) -> bytes:
    name = f"{library.package.split('/')[-1]}-{library.version}.tgz"
    kept, address = cache() / name, f"{REGISTRY}/{library.package}/-/{name}"
    if kept.is_file() and _is_intact(data := kept.read_bytes(), library):
        return data
    phase(f"downloading {name}")
    try:
        with urllib.request.urlopen(address, timeout=PATIENCE) as response:
            data = response.read()
    except (OSError, ValueError, http.client.HTTPException) as error:
        reason = getattr(error, "reason", None) or error
        raise MorlaxError(
            f"cannot download {address} ({reason}): connect to the internet once, or copy "
            f"this file to {kept}."
        ) from None
    if not _is_intact(data, library):
        raise MorlaxError(f"{address} was changed on the way (SHA-512): try another network.")
    make_folder(kept.parent)
    write_file(kept, data)
    return data


def _is_intact(data: bytes, library: Library) -> bool:
    return base64.b64encode(hashlib.sha512(data).digest()).decode() == library.sha512
