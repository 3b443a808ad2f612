"""Who may use a page: a browser at the address that the command prints, and its own scripts.

A page's path begins with a secret token, and no other web page may send a request. The token is in
the path, because browsers would send a cookie to every port of the host.
"""

import hmac
import re
import secrets

from websockets.datastructures import Headers

LOCALHOST = ("localhost", "127.0.0.1", "::1")
EVERYWHERE = {"0.0.0.0": "127.0.0.1", "::": "::1"}  # and how this machine's browser gets there


class Door:
    """The checks of each request to a server that listens on `host`."""

    def __init__(self, host: str):
        self.token = secrets.token_urlsafe(24)
        self._place = EVERYWHERE.get(host, host)
        # a page whose name resolves to this machine (DNS rebinding) names itself as the host
        self._hosts = {_in_address(name) for name in LOCALHOST} if host in LOCALHOST else None

    def address(self, port: int) -> str:
        """Return what a browser must open."""
        return f"http://{_in_address(self._place)}:{port}/{self.token}/"

    def admits(self, path: str, headers: Headers) -> str | None:
        """Return the path below the token; None if the request may not come in."""
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if len(hosts) != 1:
            return None
        if self._hosts is not None and re.sub(r":\d+$", "", hosts[0]) not in self._hosts:
            return None
        if origins not in ([], [f"http://{hosts[0]}"], [f"https://{hosts[0]}"]):
            return None
        token, _, rest = path.partition("?")[0].removeprefix("/").partition("/")
        known = hmac.compare_digest(token.encode(errors="replace"), self.token.encode())
        return rest if known else None


def _in_address(host: str) -> str:
    return f"[{host}]" if ":" in host else host
