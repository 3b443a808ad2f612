"""Show a robot live in the browser, and change its trade-off while it moves."""

import socket
from collections.abc import Sequence
from typing import Annotated

import tyro

from .envs import MorlaxError
from .terminal import cli
from .terminal.help import call
from .terminal.interrupt import interruptible


def explore(run: str, host: str, port: int) -> None:
    """Serve the page of a run until Ctrl-C.

    Args:
        run: a run's folder, a checkpoint file, or a shipped policy.
        host: address to listen on.
        port: TCP port to listen on; 0 selects a free one.

    Raises:
        MorlaxError: there is no such run, it has no checkpoint, viser is not installed, or the
            address cannot be listened on.
    """
    from .viewers.explorer import library

    library.choose(run)  # importing viser takes seconds: report a wrong name first
    _check_free(host, port)
    try:
        from .viewers.explorer.page import Page
    except ModuleNotFoundError as error:
        if error.name not in ("viser", "trimesh"):
            raise
        raise MorlaxError(
            "the page needs viser, which is not installed: pip install 'morlax-torch[explore]'."
        ) from None
    import torch

    from .gpu.threads import one_thread

    with interruptible() as ended, one_thread(torch.device("cpu")):
        page = Page(run, host, port)
        cli.console.print(f"open {page.address}  (Ctrl-C to stop)", markup=False, soft_wrap=True)
        page.serve(ended)
        page.stop()


def command(arguments: Sequence[str]) -> None:
    def main(
        run: Annotated[
            str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[RUN|NAME]")
        ] = None,
        host: str = "127.0.0.1",
        port: int = 8080,
        trust: bool = False,
    ) -> None:
        """Serve a page that shows a robot live, with a slider for each objective.

        Args:
            run: Run folder, checkpoint file, or shipped policy (None: the first shipped policy,
                or the latest run under ./runs if no policy is shipped).
            host: Address to listen on; 0.0.0.0 accepts connections from the whole network.
            port: TCP port to listen on; 0 selects a free one.
            trust: Let the run import the FILE.py or module that its task names.
        """
        from .runs.loading import trust_task  # imports torch
        from .viewers.explorer import library

        chosen = run or library.first()
        if trust:
            trust_task(chosen)
        explore(chosen, host, port)

    call(main, arguments, "morlax explore")


def _check_free(host: str, port: int) -> None:
    """Check that the address is free.

    viser would silently take another port, or wait forever for an invalid address.

    Raises:
        MorlaxError: the port is out of range, or the address cannot be listened on.
    """
    if not 0 <= port < 2**16:
        raise MorlaxError(f"--port must be from 0 to 65535, not {port}.")
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as trial:
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            trial.bind(address)
    except (OSError, ValueError) as error:  # a name such as ".." is a UnicodeError
        reason = getattr(error, "strerror", "not a host name")
        raise MorlaxError(
            f"cannot listen on {host}, port {port} ({reason}): choose another --port or --host."
        ) from None


def main() -> None:
    cli.run(command)


if __name__ == "__main__":
    main()
