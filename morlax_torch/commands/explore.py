"""Show a robot live in the browser, and change its trade-off while it moves."""

from collections.abc import Sequence
from functools import partial
from typing import Annotated

from .terminal import cli
from .terminal.arguments import Positional, Served, Trusting, arg, parse


class Explore(Trusting, Served):
    """Serve a page that shows a robot live, with a slider for each objective."""

    run: Annotated[str | None, Positional, arg(metavar="[RUN|NAME]")] = None
    """Run folder (runs/TASK or latest: the newest run), checkpoint file, or shipped policy (None:
    the first shipped policy, or the newest run if none is shipped)."""


def command(arguments: Sequence[str]) -> None:
    options = parse(Explore, arguments)
    with cli.Live():
        from ..runs.loading import trust_run  # imports torch
        from ..viewers.explorer import library

        run = options.run or library.first()
        trust_run(run, options.trust, options.env)
        choice = library.choose(run)
        import torch

        from ..host.resources import one_thread
        from ..viewers.explorer.exhibits import RunExhibit

    with one_thread(torch.device("cpu")):
        options.serve(partial(RunExhibit, choice))
    cli.skip_teardown()  # which would wait for the thread of a search
