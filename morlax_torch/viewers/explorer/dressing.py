"""The title, the icon and the phone's layout of the page that viser serves."""

import gzip
import re
from functools import lru_cache
from html import escape
from urllib.parse import quote

from websockets.http11 import Response

TITLE = "MORLAX explorer"
ICON = (
    "<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 32 32'>"
    "<path d='M4 5v23h24' fill='none' stroke='#868e96' stroke-width='3'/>"
    "<circle cx='9' cy='9' r='3.2' fill='#e69f00'/><circle cx='17' cy='11' r='3.2' fill='#009e73'/>"
    "<circle cx='23' cy='16' r='3.2' fill='#56b4e9'/><circle cx='25' cy='23' r='3.2' "
    "fill='#0072b2'/></svg>"
)
# the ends of a slider's range, which viser writes where the slider's thumb covers them
SLIDER = ".mantine-Slider-markLabel { margin-top: 0.25rem; }"
# viser's sheet at the bottom of a phone is 20em wide; its elements have no names of their own
PHONE = """
@media (max-width: 36em) {
  div[style*="position: fixed"][style*="width: 20em"],
  div[style*="position: fixed"] div[style="width: 20em;"] { width: 100vw !important; }
}
"""


def dressed(response: Response) -> Response:
    """Return viser's page with our title, icon and style; anything else stays as it is."""
    if response.status_code != 200 or "html" not in response.headers.get("Content-Type", ""):
        return response
    packed = response.headers.get("Content-Encoding") == "gzip"
    response.body = _dress(bytes(response.body or b""), packed)
    del response.headers["Content-Length"]
    response.headers["Content-Length"] = str(len(response.body))
    return response


@lru_cache(maxsize=2)
def _dress(body: bytes, packed: bool) -> bytes:
    page = gzip.decompress(body) if packed else body
    icon = f'<link rel="icon" href="data:image/svg+xml,{quote(ICON)}">'
    head = f"<title>{escape(TITLE)}</title>{icon}<style>{SLIDER}{PHONE}</style>".encode()
    page = re.sub(rb'<link\s+rel="icon".*?/>', b"", page, count=1, flags=re.DOTALL)
    page = re.sub(rb"<title>.*?</title>", lambda _: head, page, count=1, flags=re.DOTALL)
    return gzip.compress(page) if packed else page
