"""Share runs: as small folders, or as a web page."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from ..envs import MorlaxError
from .terminal import cli
from .terminal.arguments import Positional, Trusting, arg, parse
from .terminal.process import typed


class Pack(Trusting):
    """Share runs: a run as a small folder (RUN FOLDER), or runs as a web page (RUN ... --web).

    RUN FOLDER writes a run's policies, front, config and training curve. Every command accepts the
    folder as a run, but training cannot continue from it.

    RUN ... --web FOLDER writes a page on which the robots move in any browser, with a slider for
    each objective. A static web server is enough: python -m http.server -d FOLDER.
    """

    runs: Annotated[tuple[str, ...], Positional, arg(metavar="RUN ...", help_behavior_hint="")]
    """Run folders (their best checkpoints), checkpoints or shipped policies; without --web one of
    them, and then a new folder."""
    web: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """New folder for a web page; needs the extra onnx, and once the internet."""
    device: str | None = None
    """Device that evaluates a run without a front: cuda, cpu, ... (None: CUDA if there is one)."""


def command(arguments: Sequence[str]) -> None:
    options = parse(Pack, arguments)
    web, runs = options.web, options.runs if options.web else options.runs[:1]
    if not runs or not (web or len(options.runs) == 2):
        raise MorlaxError(
            "name a run and a new folder (RUN FOLDER), or runs and a folder for their web page "
            "(RUN ... --web FOLDER)."
        )
    with cli.Live():
        from ..runs.loading import pack, trust_run  # imports torch

        for run in runs:
            trust_run(run, options.trust, options.env)
        if web:
            from ..viewers.web.writing import write_page

            size = write_page(runs, web, options.device) / 1e6
            cli.console.print(f"written: {web} ({size:.1f} MB)")
            cli.print_command("see it", f"python -m http.server -d {shlex.quote(str(web))}")
            return
        folder = Path(options.runs[1])
        front = pack(runs[0], folder, options.device)
        size = sum(path.stat().st_size for path in folder.rglob("*.*")) / 1e6
        cli.console.print(f"hypervolume {front.hypervolume:.4e}; written: {folder} ({size:.1f} MB)")
        trust = ["--trust"] * options.trust
        cli.print_command("use it", typed("evaluate", folder, *trust))
