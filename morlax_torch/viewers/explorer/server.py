"""A web server for one page: its files, a websocket for each tab, and who may use them.

A browser must be at the address that the command prints, whose path begins with a secret token: a
cookie would go to every port of the host. No other web page may send a request.
"""

import asyncio
import errno
import hmac
import logging
import re
import secrets
import socket
import threading
from collections.abc import Callable, Mapping
from http import HTTPStatus
from pathlib import Path

from ...envs.errors import MorlaxError, require

require("websockets", "websockets", "14", "explore")

from websockets.asyncio.server import ServerConnection, broadcast, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.protocol import State

SOCKET = "socket"  # path of the websocket
FORBIDDEN = "Open the address that the command printed: it ends with a secret token.\n"
LARGEST = 2**16  # bytes of a browser's message; the page needs a few hundred
BEHIND = 2**20  # bytes that a tab has not received yet, above which it misses frames
PARTING = 1.0  # s to wait for tabs when the server stops; they may not read, or not answer
MOST_TAKEN = 20  # ports in a row that other programs may use
TYPES = {".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
LOCALHOST = ("localhost", "127.0.0.1", "::1")
EVERYWHERE = {"0.0.0.0": "127.0.0.1", "::": "::1"}  # and how this machine's browser gets there
Hear = Callable[[ServerConnection, str | bytes | None], None]


def _in_address(host: str) -> str:
    return f"[{host}]" if ":" in host else host


class Server:
    """Serves files and websockets, from a thread of its own; browsers open `address`.

    The files are given by path; "" is the page. The port may be the next free one; 0 selects any.
    `hear` is called in the server's thread with each message of a tab, and with None when a tab has
    connected, which is then one of `tabs`. Raises MorlaxError if the address cannot be listened on.
    """

    def __init__(self, files: Mapping[str, bytes], host: str, port: int, hear: Hear):
        self._socket = listening(host, port)
        self._files, self._hear = files, hear
        self._token, self.tabs = secrets.token_urlsafe(24), set[ServerConnection]()
        # a page whose name resolves to this machine (DNS rebinding) names itself as the host
        self._hosts = {_in_address(name) for name in LOCALHOST} if host in LOCALHOST else None
        self._loop, self._over = asyncio.new_event_loop(), asyncio.Event()
        # broken connections and requests that are not HTTP are no errors of ours
        logging.getLogger("websockets.server").setLevel(logging.CRITICAL)
        name, port = _in_address(EVERYWHERE.get(host, host)), self._socket.getsockname()[1]
        self.address = f"http://{name}:{port}/{self._token}/"
        run = self._loop.run_until_complete
        self._thread = threading.Thread(target=run, args=(self._listen(),), daemon=True)
        self._thread.start()

    async def _listen(self) -> None:
        options = {"process_request": self._answer, "max_size": LARGEST, "compression": None}
        async with serve(self._talk, sock=self._socket, **options):  # type: ignore[arg-type]
            await self._over.wait()

    def send(self, message: str | bytes, to: ServerConnection | None = None) -> None:
        """Send a message to one tab, or to all that got one before; from any thread, at once."""
        self._loop.call_soon_threadsafe(self._send, message, to)

    def stop(self) -> None:
        """Disconnect the browsers and stop; a thread may still wait for those that do not read."""
        self._loop.call_soon_threadsafe(self._over.set)
        self._thread.join(PARTING)

    def _send(self, message: str | bytes, to: ServerConnection | None) -> None:
        """Send; a tab whose connection is too slow misses poses, which others replace soon."""
        if to is not None and to.state is State.OPEN:
            self.tabs.add(to)
        # a broken connection is open until its handler has run, and asyncio logs what it gets
        tabs = [x for x in (self.tabs if to is None else [to]) if not x.transport.is_closing()]
        if to is None and isinstance(message, bytes):
            tabs = [tab for tab in tabs if tab.transport.get_write_buffer_size() < BEHIND]
        broadcast(tabs, message)

    async def _talk(self, tab: ServerConnection) -> None:
        try:
            self._hear(tab, None)
            async for message in tab:
                self._hear(tab, message)
        except ConnectionClosed:
            pass
        finally:
            self.tabs.discard(tab)

    def _admitted(self, path: str, headers: Headers) -> str | None:
        """Return the path below the token; None if the request may not come in."""
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if len(hosts) != 1:
            return None
        if self._hosts is not None and re.sub(r":\d+$", "", hosts[0]) not in self._hosts:
            return None
        if origins not in ([], [f"http://{hosts[0]}"], [f"https://{hosts[0]}"]):
            return None
        token, _, rest = path.partition("?")[0].removeprefix("/").partition("/")
        right = hmac.compare_digest(token.encode(errors="replace"), self._token.encode())
        return rest if right else None

    def _answer(self, tab: ServerConnection, request: Request) -> Response | None:
        """Return a file; None lets a websocket connect."""
        path = self._admitted(request.path, request.headers)
        if path is None:
            return tab.respond(HTTPStatus.FORBIDDEN, FORBIDDEN)
        if path == SOCKET:
            return None
        if path not in self._files:
            return tab.respond(HTTPStatus.NOT_FOUND, "There is no such file.\n")
        if path == "" and not request.path.partition("?")[0].endswith("/"):
            moved = tab.respond(HTTPStatus.PERMANENT_REDIRECT, "")
            moved.headers["Location"] = f"/{self._token}/"
            return moved
        kind = TYPES.get(Path(path).suffix, "text/plain") if path else "text/html; charset=utf-8"
        body = self._files[path]
        headers = Headers({"Content-Type": kind, "Content-Length": str(len(body))})
        headers.update({"Connection": "close", "Referrer-Policy": "no-referrer"})
        return Response(HTTPStatus.OK, "OK", headers, body)


def listening(host: str, port: int) -> socket.socket:
    """Return a socket that listens on the first free port from `port` on, of a few."""
    if not 0 <= port < 2**16:
        raise MorlaxError(f"--port must be from 0 to 65535, not {port}.")
    last = min(port + MOST_TAKEN, 2**16 - 1)
    while True:
        try:
            family, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
            return socket.create_server(address[:2], family=family)
        except (OSError, ValueError) as error:  # a name such as ".." is a UnicodeError
            if getattr(error, "errno", None) != errno.EADDRINUSE or port == last:
                reason = getattr(error, "strerror", "not a host name")
                raise MorlaxError(
                    f"cannot listen on {host}, port {port} ({reason}): choose another --port or "
                    "--host."
                ) from None
            port += 1
