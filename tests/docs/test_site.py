"""The documentation site builds without warnings, has no broken link, and loads nothing remote."""

import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import build_site
import pages as site
import pytest

from morlax_torch.__main__ import COMMANDS

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
REMOTE = re.compile(r"(?:https?:)?//")


class Page(HTMLParser):
    """The links, loaded files and anchors of a page."""

    def __init__(self, path: Path):
        super().__init__()
        self.links, self.loads, self.anchors = [], [], set()
        self.feed(path.read_text())

    def handle_starttag(self, tag, attrs):
        named = dict(attrs)
        self.anchors.add(named.get("id"))
        if tag == "a" and "href" in named:
            self.links.append(named["href"])
        elif tag == "link" or "src" in named:
            self.loads.append(named.get("src") or named["href"])


def broken(root: Path) -> list[str]:
    """Return the links of a site that lead nowhere, and files that it loads from other hosts."""
    pages = {path.resolve(): Page(path) for path in root.rglob("*.html") if path.name != "404.html"}
    found = []
    for path, page in pages.items():
        found += [f"{path}: {file}" for file in page.loads if REMOTE.match(file)]
        for link in page.links + page.loads:
            if re.match(r"[a-z]+:|//", link):
                continue
            place, _, anchor = unquote(link).partition("#")
            place = place.partition("?")[0]
            target = (path.parent / place).resolve() if place else path
            target = target / "index.html" if target.is_dir() else target
            known = pages[target].anchors if target in pages else {anchor}
            if not target.is_file() or (anchor and anchor not in known):
                found.append(f"{path}: {link}")
    return found


@pytest.fixture
def player(tmp_path, monkeypatch) -> Path:
    """A folder in place of a real web player, which needs libraries from the internet."""
    folder = tmp_path / "player"
    folder.mkdir()
    (folder / "index.html").write_text("<title>stand-in</title>")
    for module in (site, build_site):
        monkeypatch.setattr(module, "PLAYER", folder)
    return folder


@pytest.mark.slow
def test_the_site_builds_strictly_and_all_its_links_work(tmp_path, player):
    pytest.importorskip("zensical", reason="needs the extra docs")
    pytest.importorskip("mkdocstrings_handlers.python", reason="needs the extra docs")
    build_site.build(tmp_path / "site")
    assert broken(tmp_path / "site") == []
    assert (tmp_path / "site" / "player" / "index.html").is_file()
    assert 'src="player/index.html?embed"' in (tmp_path / "site" / "index.html").read_text()
    reference = (tmp_path / "site" / "reference" / "index.html").read_text()
    assert all(f"usage: morlax {name}" in reference for name in COMMANDS)
    for name in re.findall(r"<!-- api: (\S+) -->", (DOCS / "reference.md").read_text()):
        assert f'id="{name}"' in reference, name


def test_every_page_is_in_the_navigation():
    config = (DOCS / "site" / "mkdocs.yml").read_text()
    listed = set(re.findall(r": (\S+\.md)$", config, re.MULTILINE)) - set(site.FROM_ROOT.values())
    pages = {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")}
    assert listed == pages, "list the page under nav in docs/site/mkdocs.yml"
