"""Build the documentation site, strictly and offline: `python docs/site/build_site.py FOLDER`.

The environment variable REPOSITORY_URL is where links to source code lead.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from pages import DOCS, FROM_ROOT, PLAYER, ROOT, rendered

CONFIG = DOCS / "site" / "mkdocs.yml"


def build(output: Path, repository: str | None = None) -> None:
    """Write the site to the new folder `output`.

    Raises:
        SystemExit: there is a warning, such as a broken link.
    """
    if output.exists():
        sys.exit(f"{output} exists already: name a new folder.")
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        prepare(place, repository)
        done = subprocess.run(
            [sys.executable, "-m", "zensical", "build", "--strict", "--config-file", "mkdocs.yml"],
            cwd=place,
        )
        if done.returncode:
            sys.exit("the site has warnings: see above.")
        shutil.copytree(place / "site", output)


def prepare(place: Path, repository: str | None) -> None:
    """Write the pages, the package that they document, and the config, for Zensical."""
    pages = place / "pages"
    others = shutil.ignore_patterns("site", PLAYER.name, "gallery.py", "*.md")
    shutil.copytree(DOCS, pages, ignore=others)
    if PLAYER.is_dir():
        shutil.copytree(PLAYER, pages / "player")
    sources = {path.relative_to(DOCS).as_posix(): path for path in sorted(DOCS.rglob("*.md"))}
    sources |= {page: ROOT / path for path, page in FROM_ROOT.items()}
    for page, source in sources.items():
        (pages / page).write_text(rendered(source, repository))
    package = place / "package" / "morlax_torch"  # with envs/ and configs/, as installed
    code = shutil.ignore_patterns("shipped", "assets", "__pycache__")
    shutil.copytree(ROOT / "morlax_torch", package, ignore=code)
    for name in ("envs", "configs"):
        shutil.copytree(ROOT / name, package / name, ignore=code)
    address = f"\nrepo_url: {repository}\n" if repository else ""
    (place / "mkdocs.yml").write_text(CONFIG.read_text() + address)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="a new folder")
    build(parser.parse_args().folder, os.environ.get("REPOSITORY_URL"))
