"""A web server for one page: its files, and a websocket for each of its tabs."""

import asyncio
import gzip
import logging
import mimetypes
import threading
from collections.abc import Callable, Mapping
from functools import cache
from http import HTTPStatus

from websockets.asyncio.server import ServerConnection, broadcast, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.protocol import State

from ...envs import MorlaxError
from .access import Door

SOCKET = "socket"  # path of the websocket
FORBIDDEN = "Open the address that the command printed: it ends with a secret token.\n"
LARGEST = 2**16  # bytes of a browser's message; the page needs a few hundred
BEHIND = 2**20  # bytes that a tab has not received yet, above which it misses frames
PARTING = 1.0  # s to wait for tabs when the server stops; they may not read, or not answer
TYPES = {".js": "text/javascript", ".html": "text/html; charset=utf-8"}


class Server:
    """Serves files and websockets, from a thread of its own. `address` is what browsers open.

    Args:
        files: by path; "" is the page.
        host: address to listen on.
        port: TCP port to listen on; 0 selects a free one.
        hear: called with each message of a browser, in the server's thread.
        greet: called with each new connection, in the server's thread; then `join` it.

    Raises:
        MorlaxError: another program has taken the port.
    """

    def __init__(
        self,
        files: Mapping[str, bytes],
        host: str,
        port: int,
        hear: Callable[[str | bytes], None],
        greet: Callable[[ServerConnection], None],
    ):
        self._files, self._hear, self._greet = files, hear, greet
        self._door, self._tabs = Door(host), set[ServerConnection]()
        self._packed = cache(lambda path: gzip.compress(files[path]))
        self._loop, self._over = asyncio.new_event_loop(), asyncio.Event()
        ready = threading.Event()
        logging.getLogger("websockets.server").addFilter(_one_line)

        async def listen() -> None:
            options = {"process_request": self._answer, "max_size": LARGEST, "compression": None}
            async with serve(self._talk, host, port, **options) as server:  # type: ignore[arg-type]
                self.address = self._door.address(next(iter(server.sockets)).getsockname()[1])
                ready.set()
                await self._over.wait()

        def run() -> None:
            try:
                self._loop.run_until_complete(listen())
            finally:
                self._loop.close()
                ready.set()

        self._thread = threading.Thread(target=run, daemon=True)
        self._thread.start()
        ready.wait()
        if not self._thread.is_alive():
            raise MorlaxError(f"cannot listen on {host}, port {port}: choose another --port.")

    def send(self, message: str | bytes, to: ServerConnection | None = None) -> None:
        """Send a message to one tab, or to all that joined; from any thread, without waiting."""
        self._loop.call_soon_threadsafe(self._send, message, to)

    def join(self, tab: ServerConnection) -> None:
        """Send a tab what all get, from now on."""
        self._loop.call_soon_threadsafe(self._join, tab)

    def stop(self) -> None:
        """Disconnect the browsers and stop; a thread may still wait for those that do not read."""
        self._loop.call_soon_threadsafe(self._over.set)
        self._thread.join(PARTING)

    def _send(self, message: str | bytes, to: ServerConnection | None) -> None:
        """Send; a tab whose connection is too slow misses poses, which others replace soon."""
        tabs = [
            tab
            for tab in (self._tabs if to is None else [to])
            # a broken connection is open until its handler has run, and asyncio logs what it gets
            if not tab.transport.is_closing()
        ]
        if to is None and isinstance(message, bytes):
            tabs = [tab for tab in tabs if tab.transport.get_write_buffer_size() < BEHIND]
        broadcast(tabs, message)

    def _join(self, tab: ServerConnection) -> None:
        if tab.state is State.OPEN:
            self._tabs.add(tab)

    async def _talk(self, tab: ServerConnection) -> None:
        try:
            self._greet(tab)
            async for message in tab:
                self._hear(message)
        except ConnectionClosed:
            pass
        finally:
            self._tabs.discard(tab)

    def _answer(self, tab: ServerConnection, request: Request) -> Response | None:
        """Return a file; None lets a websocket connect."""
        path = self._door.admits(request.path, request.headers)
        if path is None:
            return tab.respond(HTTPStatus.FORBIDDEN, FORBIDDEN)
        if path == SOCKET:
            return None
        if path not in self._files:
            return tab.respond(HTTPStatus.NOT_FOUND, "There is no such file.\n")
        if path == "" and not request.path.partition("?")[0].endswith("/"):
            moved = tab.respond(HTTPStatus.PERMANENT_REDIRECT, "")
            moved.headers["Location"] = f"/{self._door.token}/"
            return moved
        ending = path[path.rfind(".") :] if path else ".html"
        kind = TYPES.get(ending) or mimetypes.guess_type(path)[0] or "application/octet-stream"
        packed = "gzip" in request.headers.get("Accept-Encoding", "")
        body = self._packed(path) if packed else self._files[path]
        headers = Headers({"Content-Type": kind, "Content-Length": str(len(body))})
        headers.update({"Connection": "close", "Referrer-Policy": "no-referrer"})
        if packed:
            headers["Content-Encoding"] = "gzip"
        return Response(HTTPStatus.OK, "OK", headers, body)


def _one_line(record: logging.LogRecord) -> bool:
    """Log a broken connection as one line, and a request that is not HTTP not at all."""
    if record.exc_info:
        record.msg, record.exc_info = f"{record.msg}: {record.exc_info[1]!r}", None
    return not record.msg.startswith("opening handshake failed")
