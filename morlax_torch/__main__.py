"""All commands under one name: `morlax train ...` or `python -m morlax_torch train ...`."""

import importlib
from collections.abc import Sequence

from .commands.terminal import cli
from .commands.terminal.process import program
from .envs import MorlaxError
from .envs.errors import unknown

COMMANDS = {
    "train": "train one hypernetwork to hold a whole Pareto front",
    "evaluate": "measure the fronts of trained runs",
    "figures": "write figures and a table of evaluated runs for a paper",
    "choose": "find the trade-off that meets a requirement",
    "design": "find the body and the trade-off that serve best",
    "explore": "steer a robot live in the browser",
    "record": "film a robot under several trade-offs",
    "export": "write a policy to a file that runs without this package",
    "play": "run an exported policy in C MuJoCo",
    "pack": "copy what is needed to use a run into a small folder",
}


def command(arguments: Sequence[str]) -> None:
    if not arguments or arguments[0] in ("-h", "--help"):
        typed = program("COMMAND")
        cli.console.print(f"usage: {typed} ... ({typed} --help for its options)")
        for name, about in COMMANDS.items():
            cli.console.print(f"  {name:9} {about}")
        cli.console.print("  --version print the version")
        if not arguments:
            raise MorlaxError("name a command of this list.")
        return
    name, *rest = arguments
    if name not in COMMANDS:
        raise unknown("command", name, COMMANDS)
    importlib.import_module(f"{__package__}.commands.{name}").command(rest)


def main() -> None:
    cli.run(command)


if __name__ == "__main__":
    main()
