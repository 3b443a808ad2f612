"""Show a robot live in the browser, and change its trade-off while it moves."""

import os
from collections.abc import Sequence
from queue import Queue
from typing import Annotated

from .terminal import cli
from .terminal.arguments import Positional, Trusting, arg, parse
from .terminal.process import interruptible

BESIDE = "MORLAX_BESIDE"  # variable: ID of the process that trains what this command shows
NICE = 10


class Explore(Trusting):
    """Serve a page that shows a robot live, with a slider for each objective."""

    run: Annotated[str, Positional, arg(metavar="[RUN|NAME]")] = "ant"
    """Run folder (runs/TASK or latest: the newest run), checkpoint file, or shipped policy."""
    tradeoff: Annotated[str | None, arg(metavar="0.8,0.2")] = None
    """Weights to open with, @NAME of a bookmark, or FILE.yaml of a trade-off over time, which moves
    the sliders until you do (None: the balanced trade-off)."""
    host: Annotated[str, arg(metavar="ADDRESS")] = "127.0.0.1"
    """Address to listen on; 0.0.0.0 accepts connections from the whole network."""
    port: Annotated[int, arg(metavar="NUMBER")] = 8080
    """TCP port to listen on, or the next free one; 0 selects any."""


def command(arguments: Sequence[str]) -> None:
    options = parse(Explore, arguments)
    with cli.Live():
        from ..runs.loading import moving_tradeoff_of, trust_run  # imports torch
        from ..viewers.explorer import library

        run, text = options.run, options.tradeoff
        trust_run(run, options.trust, options.env)
        choice = library.choose(run)
        tradeoff = None if text is None else moving_tradeoff_of(text, run)
        import torch

        from ..host.files import runs
        from ..host.resources import one_thread
        from ..viewers.explorer.exhibits import RunExhibit
        from ..viewers.explorer.page import Page

    trainer = int(os.environ.get(BESIDE, "0"))
    if trainer and hasattr(os, "nice"):
        os.nice(NICE)
    with one_thread(torch.device("cpu")), interruptible() as received:
        with cli.Live():
            # a SimpleQueue waits forever if a signal interrupts it about when its timeout ends
            queue = Queue()
            page = Page(RunExhibit(choice, queue.put, tradeoff), queue, options.host, options.port)
        cli.console.print(f"open {page.address}  (Ctrl-C to stop)", soft_wrap=True)
        page.serve(lambda: bool(received) or (trainer > 0 and not runs(trainer)))
    cli.skip_teardown()  # which would wait for the thread of a search
