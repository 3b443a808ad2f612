"""Write a task file for a robot's MJCF."""

import os
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from ..envs import MorlaxError
from ..envs.worlds.options import Section
from ..host.files import write_file
from ..host.machine import gpu
from .terminal import cli
from .terminal.arguments import Positional, arg, parse
from .terminal.process import typed


class New(Section):
    """Write a task file for your own robot, ready to train.

    Robots that can fall get speed along x against energy saved; others reach for random targets
    with an end effector. Then edit the file: comments say what its numbers mean.
    """

    model: Annotated[Path, Positional, arg(metavar="FILE.xml")]
    """The robot's MJCF."""
    output: Path | None = None
    """Python file to write, after which the class is named (None: beside the MJCF)."""


def command(arguments: Sequence[str]) -> None:
    options = parse(New, arguments)
    named = options.output or options.model
    file = named.parent / f"{named.stem}.py"
    if file.exists():
        raise MorlaxError(f"{file} exists already: name another file with --output.")
    if file.stem in {*sys.stdlib_module_names, "mujoco", "numpy", "torch"}:
        raise MorlaxError(f"{file} would hide the module {file.stem}: name another with --output.")
    with cli.Live():
        from ..envs.worlds.drafts import WORDS, Draft  # imports MuJoCo

        draft = Draft(options.model)
    name = "".join(word[:1].upper() + word[1:] for word in re.split(r"[\W_]+", file.stem))
    name = name if name.isidentifier() and name not in WORDS else f"Robot{name}"
    write_file(file, draft.text(name, os.path.relpath(options.model, file.parent)))
    goal = "runs along x" if draft.floating else "reaches for targets"
    cli.console.print(f"written: {file}, in which {name} {goal}, or saves energy")
    fitted = ("--worlds", 256, "--evaluation.tradeoffs", 16) if gpu() is None else ()
    task = "--env", f"{file}:{name}", "--max-seconds", 120
    cli.print_command("next", typed("train", *task, *fitted))
