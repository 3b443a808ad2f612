"""Turn the Markdown of docs/, as GitHub shows it, into pages of the site."""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
FROM_ROOT = {"CHANGELOG.md": "changelog.md", "CONTRIBUTING.md": "contributing.md"}
GITHUB = "https://github.com/"
COLAB = "https://colab.research.google.com/github/"
PLAYER = DOCS / "player"  # made by `pack --web`, not part of the repository
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\[\]]*\])*)\]\(([^)#\s]+)(#[^)\s]*)?\)")
FENCE = re.compile(r"^```.*?^```$", re.DOTALL | re.MULTILINE)
MARK = re.compile(r"^<!-- (help|api|player)(?:: (\S+))? -->$", re.MULTILINE)


def rendered(source: Path, repository: str | None) -> str:
    """Return the text of a page of the site.

    Args:
        source: the Markdown file, in docs/ or at the top level.
        repository: address of the repository, where links to source code lead (None: they become
            plain text).
    """
    text = outside_code(source.read_text(), lambda part: relinked(part, source, repository))
    marks: dict[str, Callable[[str], str]] = {"help": help_of, "api": "::: {}".format}
    return MARK.sub(lambda mark: marks.get(mark[1], player)(mark[2]), text)


def outside_code(text: str, change: Callable[[str], str]) -> str:
    """Return `text` with a change to everything except its code blocks."""
    done, position = [], 0
    for block in FENCE.finditer(text):
        done += [change(text[position : block.start()]), block[0]]
        position = block.end()
    return "".join([*done, change(text[position:])])


def relinked(text: str, source: Path, repository: str | None) -> str:
    """Return `text` with its links to files made those of the site."""

    def link(found: re.Match) -> str:
        image, label, target, anchor = found[1], found[2], found[3], found[4] or ""
        if ":" in target:
            return found[0]
        path = (source.parent / target).resolve().relative_to(ROOT)
        if not (ROOT / path).exists():
            raise FileNotFoundError(f"{source.name} links to {target}, which does not exist")
        if path.as_posix() in FROM_ROOT:
            return f"[{label}]({FROM_ROOT[path.as_posix()]}{anchor})"
        if path.is_relative_to("docs") and (ROOT / path).is_file():
            place = os.path.relpath(ROOT / path, DOCS if source.parent == ROOT else source.parent)
            colab = ""
            if path.suffix == ".ipynb" and repository and repository.startswith(GITHUB):
                address = f"{repository.replace(GITHUB, COLAB)}/blob/main/{path.as_posix()}"
                colab = f" ([open in Colab]({address}))"
            return f"{image}[{label}]({Path(place).as_posix()}{anchor}){colab}"
        if repository is None:
            return label
        return f"[{label}]({repository}/tree/main/{path.as_posix()}{anchor})"

    return LINK.sub(link, text)


def help_of(command: str) -> str:
    """Return a code block with the `--help` of a command."""
    done = subprocess.run(
        [sys.executable, "-m", "morlax_torch", command, "--help"],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "COLUMNS": "82", "NO_COLOR": "1", "TERM": "dumb"},
    )
    text = done.stdout.strip().replace("usage: python -m morlax_torch ", "usage: morlax ", 1)
    lines = [line.rstrip() for line in text.splitlines()]
    return "\n".join(["```text", *lines, "```"])


def player(_: str | None) -> str:
    """Return a frame with the web player, if there is one in PLAYER."""
    if not (PLAYER / "index.html").is_file():
        return ""
    frame = (
        '<iframe src="player/index.html?embed" title="Trained robots in the browser" '
        'loading="lazy" style="width: 100%; height: clamp(420px, 78vh, 640px); border: 0"></iframe>'
    )
    link = '<a href="player/index.html">Open it on a page of its own</a>'
    return f"{frame}\n\n{link}, or [make such a page](explore.md#web-page) of your own runs."
