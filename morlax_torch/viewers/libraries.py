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

import yaml

from ..envs import MorlaxError
from ..host.files import make_folder, write_file
from ..host.phases import phase

REGISTRY = "https://registry.npmjs.org"
PATIENCE = 60  # s without an answer
HERE = Path(__file__).parent


class Library(NamedTuple):
    """An entry of libraries.yaml."""

    package: str
    version: str
    sha512: str
    files: dict[str, str]
    license: str | None = None

    @property
    def name(self) -> str:
        return self.package.rpartition("/")[2]


LIBRARIES = [Library(**entry) for entry in yaml.safe_load((HERE / "libraries.yaml").read_text())]


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
            license = HERE / "licenses" / library.license
            contents[f"{library.name}.LICENSE.txt"] = license.read_bytes()
        with tarfile.open(fileobj=io.BytesIO(_archive(library)), mode="r:gz") as archive:
            for path, name in library.files.items():
                file = archive.extractfile(f"package/{path}")
                assert file is not None, path
                contents[name] = file.read()
    return contents


def _archive(library: Library) -> bytes:
    name = f"{library.name}-{library.version}.tgz"
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    copy, address = cache / "morlax_torch/web" / name, f"{REGISTRY}/{library.package}/-/{name}"
    if copy.is_file() and _is_intact(data := copy.read_bytes(), library):
        return data
    phase(f"downloading {name}")
    try:
        with urllib.request.urlopen(address, timeout=PATIENCE) as response:
            data = response.read()
    except (OSError, ValueError, http.client.HTTPException) as error:
        reason = getattr(error, "reason", None) or error
        raise MorlaxError(
            f"cannot download {address} ({reason}): connect to the internet once, or copy "
            f"this file to {copy}."
        ) from None
    if not _is_intact(data, library):
        raise MorlaxError(f"{address} was changed on the way (SHA-512): try another network.")
    make_folder(copy.parent)
    write_file(copy, data)
    return data


def _is_intact(data: bytes, library: Library) -> bool:
    return base64.b64encode(hashlib.sha512(data).digest()).decode() == library.sha512
