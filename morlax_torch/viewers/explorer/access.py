"""Who may use the explorer: its own page, opened at the address that the command prints.

viser answers every program and every web page that knows the port. Here, each request must name a
secret token in its path, and no other web page may send it. The token is in the path because
viser's page opens its websocket at the path it was loaded from, and because browsers would send a
cookie to every port of the host.
"""

import hmac
import logging
import re
import secrets
import warnings
from collections.abc import Mapping
from dataclasses import replace
from http import HTTPStatus
from typing import Any

import viser
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection, serve
from websockets.http11 import Request, Response

from ...envs import MorlaxError
from ...envs.replacing import replaced
from .dressing import dressed
from .messages import accepted

FORBIDDEN = "Open the address that the command printed: it ends with a secret token.\n"
LOCALHOST = ("localhost", "127.0.0.1", "::1")
EVERYWHERE = {"0.0.0.0": "127.0.0.1", "::": "::1"}  # and how this machine's browser gets there
LARGEST = 2**16  # bytes of a browser's message; the page needs a few hundred


def start(host: str, port: int) -> tuple[viser.ViserServer, str]:
    """Start viser's server for its own page only.

    Args:
        host: address to listen on.
        port: TCP port to listen on; 0 selects a free one.

    Returns:
        The server, and its address with the token.

    Raises:
        MorlaxError: the checks do not fit this version of viser.
    """
    door = Door(host)
    logging.getLogger("websockets.server").addFilter(_one_line)
    warnings.filterwarnings("ignore", "Queued a .* on a closed connection")  # a browser has left
    with replaced(websockets.asyncio.server, "serve", door.serve):  # viser has no hook
        server = viser.ViserServer(host, port, verbose=False)
    widgets = getattr(server.gui, "_gui_input_handle_from_uuid", None)
    if widgets is None or not door.closed:
        server.stop()
        raise MorlaxError(
            f"viser {viser.__version__} would let any web page steer the robot: install another "
            "version, such as viser==1.1.1."
        )
    door.widgets = widgets
    place = EVERYWHERE.get(host, host)
    return server, f"http://{_in_address(place)}:{server.get_port()}/{door.token}"


class Door:
    """The checks of one server: of each request, and of each message on a websocket."""

    def __init__(self, host: str):
        self.token = secrets.token_urlsafe(24)
        self.widgets: Mapping[str, object] = {}  # by viser's uuid; browsers can set only these
        self.closed = False
        # a page whose name resolves to this machine (DNS rebinding) names itself as the host
        self._hosts = {_in_address(name) for name in LOCALHOST} if host in LOCALHOST else None

    def serve(self, *arguments: Any, **options: Any) -> serve:
        """Start a websocket server as `websockets` does, behind the checks."""
        page, door = options.get("process_request"), self

        def answer(connection: ServerConnection, request: Request) -> Response | None:
            if not door.admits(request):
                return connection.respond(HTTPStatus.FORBIDDEN, FORBIDDEN)
            response = page(connection, replace(request, path="/")) if page else None
            return dressed(response) if response else None

        class Connection(ServerConnection):
            async def recv(self, *arguments: Any) -> Any:
                while True:
                    message = accepted(await super().recv(*arguments), door.widgets)
                    if message is not None:
                        return message

        self.closed = True
        options |= {"process_request": answer, "create_connection": Connection}
        return serve(*arguments, **options | {"max_size": LARGEST})

    def admits(self, request: Request) -> bool:
        """Whether a request names the token, and comes from this server's page or from no page."""
        hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
        if len(hosts) != 1:
            return False
        if self._hosts is not None and re.sub(r":\d+$", "", hosts[0]) not in self._hosts:
            return False
        if origins not in ([], [f"http://{hosts[0]}"], [f"https://{hosts[0]}"]):
            return False
        path = request.path.partition("?")[0].strip("/")
        return hmac.compare_digest(path.encode(errors="replace"), self.token.encode())


def _in_address(host: str) -> str:
    return f"[{host}]" if ":" in host else host


def _one_line(record: logging.LogRecord) -> bool:
    """Log a broken connection as one line, and a request that is not HTTP not at all."""
    if record.exc_info:
        record.msg, record.exc_info = f"{record.msg}: {record.exc_info[1]!r}", None
    return not record.msg.startswith("opening handshake failed")
