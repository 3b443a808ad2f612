"""All commands under one name: `morlax train ...` or `python -m morlax_torch train ...`."""

import importlib
import sys
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path

from .commands.terminal import cli
from .commands.terminal.process import program, typed
from .envs.errors import installation, unknown
from .envs.naming import runs_code
from .host.files import RUNS, newest_runs, task_of
from .host.machine import gpu

COMMANDS = {
    "new": "write a task for your own robot, from its MJCF",
    "train": "train one hypernetwork to hold a whole Pareto front",
    "evaluate": "measure the fronts of trained runs",
    "choose": "find the trade-off that meets a requirement",
    "design": "find the best body and trade-off",
    "explore": "steer a robot live in the browser",
    "record": "film a robot under several trade-offs",
    "export": "write a policy to a file that runs without this package",
    "play": "run an exported policy in C MuJoCo",
    "pack": "copy what is needed to use a run into a small folder",
}


def first_commands() -> Iterator[tuple[str, str]]:
    """Yield four command lines that work here and now, each with what it gives."""
    served = find_spec("websockets") is not None
    page = "a trained robot in the browser, with a slider per objective"
    yield typed("explore", "ant"), page if served else f"needs {installation('explore')}"
    trained = "policies from fast to economical, in about a minute"
    yield typed("train", "--env", "cheetah", "--max-seconds", 10 if gpu() else 30), trained
    if run := next(filter(task_of, newest_runs(RUNS)), None):
        trust = ["--trust"] * runs_code(task_of(run))
        use = typed("explore" if served else "evaluate", "latest", *trust)
        yield use, f"your newest run, {run}"
    else:
        limits = "--at-least", "run=2000", "--maximize", "energy"
        yield typed("choose", "cheetah", *limits), "its most economical policy that is fast enough"
    model = min(Path().glob("*.xml"), default="my_robot.xml")
    yield typed("new", model), "a task for your own robot, ready to train"


def command(arguments: Sequence[str]) -> None:
    if not arguments or arguments[0] in ("-h", "--help"):
        start = program("COMMAND")
        cli.console.print(f"usage: {start} ... ({start} --help for its options)")
        if not arguments:
            cli.console.print(f"\nTo begin with, on {gpu() or 'a machine without a CUDA GPU'}:")
            for line, about in first_commands():
                cli.console.print(f"  {line}\n    {about}")
            cli.console.print("\nAll commands:")
        for name, about in COMMANDS.items():
            cli.console.print(f"  {name:9} {about}")
        cli.console.print("  --version print the version")
        return
    name, *rest = arguments
    if name not in COMMANDS:
        raise unknown("command", name, COMMANDS)
    importlib.import_module(f"{__package__}.commands.{name}").command(rest)


def main() -> None:
    sys.path.append("")  # modules in this folder, which a script's path lacks
    cli.run(command)


if __name__ == "__main__":
    main()
