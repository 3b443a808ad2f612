"""Find out whether a page can open: what is installed, and which port is free."""

import errno
import socket
from collections.abc import Iterator
from contextlib import contextmanager

from ...envs import MorlaxError
from ...envs.errors import installation

MOST_TAKEN = 20  # ports in a row that other programs may use


@contextmanager
def importing_page() -> Iterator[None]:
    """Explain what to install if an import inside fails for lack of it.

    Raises:
        MorlaxError: websockets is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "websockets":
            raise
        raise MorlaxError(
            f"the page needs websockets, which is not installed: {installation('explore')}."
        ) from None


def free_port(host: str, port: int) -> int:
    """Return the first port from `port` on that no other program uses, of a few.

    Raises:
        MorlaxError: the port is out of range, or the address cannot be listened on.
    """
    if not 0 <= port < 2**16:
        raise MorlaxError(f"--port must be from 0 to 65535, not {port}.")
    last = min(port + MOST_TAKEN, 2**16 - 1)
    while not _is_free(host, port, last):
        port += 1
    return port


def _is_free(host: str, port: int, last: int) -> bool:
    """Return whether a port is free, or raise MorlaxError if there is no use in trying another."""
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as trial:
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            trial.bind(address)
        return True
    except (OSError, ValueError) as error:  # a name such as ".." is a UnicodeError
        if getattr(error, "errno", None) == errno.EADDRINUSE and port < last:
            return False
        reason = getattr(error, "strerror", "not a host name")
        raise MorlaxError(
            f"cannot listen on {host}, port {port} ({reason}): choose another --port or --host."
        ) from None
