"""Share runs: as small folders, or as a web page."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from ..envs import MorlaxError
from .terminal import cli
from .terminal.live import Live
from .terminal.startup import program
from .terminal.task_arguments import Moved, call


def command(arguments: Sequence[str]) -> None:
    def main(
        places: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN ...")],
        web: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None,
        device: str | None = None,
        trust: bool = False,
        env: Moved = None,
    ) -> None:
        """Share runs: a run as a small folder (RUN FOLDER), or runs as a web page (RUN ... --web).

        RUN FOLDER writes a run's policies, front, config and training curve. Every command accepts
        the folder as a run, but training cannot continue from it.

        RUN ... --web FOLDER writes a page on which the robots move in any browser, with a slider
        for each objective. A static web server is enough: python -m http.server -d FOLDER.

        Args:
            places: Run folders (their best checkpoints), checkpoints or shipped policies; without
                --web one of them, and then a new folder.
            web: New folder for a web page; needs the extra onnx, and once the internet.
            device: Device that evaluates a run without a front: cuda, cpu, ... (None: CUDA if there
                is a GPU).
            trust: Let the runs import the Python files and modules that they name.
        """
        runs = places if web else places[:1]
        if not places or not (web or len(places) == 2):
            raise MorlaxError(
                "name a run and a new folder (RUN FOLDER), or runs and a folder for their web page "
                "(RUN ... --web FOLDER)."
            )
        with Live():
            from ..runs.loading import trust_run  # imports torch

            for run in runs:
                trust_run(run, trust, env)
            if web:
                _write_page(runs, web, device)
            else:
                _pack(runs[0], Path(places[1]), device, trust)

    call(main, arguments, program("pack"))


def _pack(run: str, output: Path, device: str | None, trust: bool) -> None:
    from ..runs.evaluating import pack

    front = pack(run, output, device)
    size = sum(path.stat().st_size for path in output.rglob("*.*")) / 1e6
    cli.console.print(f"hypervolume {front.hypervolume:.4e}; written: {output} ({size:.1f} MB)")
    packed = shlex.quote(str(output)) + (" --trust" if trust else "")
    cli.print_command("use it", f"{program('evaluate')} {packed}")


def _write_page(runs: Sequence[str], folder: Path, device: str | None) -> None:
    from ..viewers.web.writing import write_page

    size = sum(write_page(runs, folder, device).values()) / 1e6
    cli.console.print(f"written: {folder} ({size:.1f} MB)")
    cli.print_command("see it", f"python -m http.server -d {shlex.quote(str(folder))}")
