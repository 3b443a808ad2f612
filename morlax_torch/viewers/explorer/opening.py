"""What must hold before a page can open: viser is installed, and the address is free."""

import socket
from collections.abc import Iterator
from contextlib import contextmanager

from ...envs import MorlaxError
from ...envs.errors import installation


@contextmanager
def importing_viser() -> Iterator[None]:
    """Explain how to install viser if an import inside fails for lack of it.

    Raises:
        MorlaxError: viser is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name not in ("viser", "trimesh"):
            raise
        raise MorlaxError(
            f"the page needs viser, which is not installed: {installation('explore')}."
        ) from None


def check_free(host: str, port: int) -> None:
    """Check that an address is free.

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
