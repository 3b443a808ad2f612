"""The explorer's server: who may use it, and what it does with input that no page would send."""

import math
import signal
import subprocess
import sys
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from functools import partial
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from types import SimpleNamespace

import pytest
from browsing import PATIENCE, POSE, Client, chromium, exploring

from morlax_torch import MorlaxError, envs, save


@pytest.fixture(scope="module")
def address(tmp_path_factory, make_run) -> Iterator[str]:
    """Serve a run with a velocity command; another run lies beside it, and one outside ./runs.

    Yields the page's address; no test may make the server complain.
    """
    place = tmp_path_factory.mktemp("served")
    make_run(place / "runs/bruce/a", "bruce", "best")
    make_run(place / "runs/hopper/b", "hopper", "best")
    make_run(place / "secret", "cheetah", "best")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        with exploring("runs/bruce/a") as (printed, process):
            yield printed
            assert ended(process) == ""


def ended(process: subprocess.Popen) -> str:
    """Stop a server that must still be running, and return what it wrote to stderr."""
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    return errors


def request(address: str, **headers: str) -> tuple[int, str]:
    """Return the status and the text of a page."""
    try:
        with urllib.request.urlopen(urllib.request.Request(address, headers=headers)) as page:
            return page.status, page.read().decode()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read().decode()


def test_only_the_printed_address_opens_the_page(address):
    from websockets.exceptions import InvalidStatus

    base, _, token = address.rpartition("/")
    host = base.removeprefix("http://")
    assert len(token) >= 32
    for wrong in (base, f"{base}/", f"{base}/index.html", f"{address[:-1]}", f"{base}/?{token}"):
        status, text = request(wrong)
        assert status == 403
        assert "Open the address that the command printed" in text

    assert request(address)[0] == 200
    assert request(address)[1].count("<title>") == 1
    assert "<title>MORLAX explorer</title>" in request(address)[1]
    assert "<html" in request(f"{address}/")[1]
    assert request(address, Host=host.replace("127.0.0.1", "localhost"))[0] == 200
    for headers in ({"Host": f"rebound.example:{host.rpartition(':')[2]}"}, {"Origin": "null"}):
        assert request(address, **headers)[0] == 403

    # websockets: without the token, or from another page
    Client(address, {"Origin": base}).close()
    for wrong, origin in ((base, base), (f"{base}/x", base), (address, "http://127.0.0.1:1")):
        with pytest.raises(InvalidStatus, match="403"):
            Client(wrong, {"Origin": origin})


ATTACK = """
<script>
const socket = new WebSocket('{address}', ['viser-v{version}']);
socket.onopen = () => document.title = 'connected';
socket.onerror = () => document.title = 'refused';
</script>
"""


@pytest.fixture
def foreign() -> Iterator[tuple[str, dict[str, str]]]:
    """Another web server on this machine: its address, and its pages by path."""
    pages: dict[str, str] = {}

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.end_headers()
            self.wfile.write(pages.get(self.path, "").encode())

        def log_message(self, format: str, *args: object) -> None:
            pass

    with HTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}", pages
        server.shutdown()
        thread.join()


@pytest.mark.slow
def test_a_foreign_page_cannot_connect(address, foreign):
    import viser

    elsewhere, pages = foreign
    base = address.rpartition("/")[0]
    for path, target in (("/blind", base), ("/knowing", address)):
        websocket = "ws" + target.removeprefix("http")
        pages[path] = ATTACK.format(address=websocket, version=viser.__version__)
    with chromium() as browser:
        context = browser.new_context()  # whose user has opened the explorer too
        context.set_default_timeout(1000 * PATIENCE)
        page = context.new_page()
        page.goto(address)
        page.wait_for_selector("[data-tradeoff]", state="attached")
        assert context.cookies() == []  # browsers would send them to the other server
        for path in pages:
            tab = context.new_page()
            tab.goto(elsewhere + path)
            tab.wait_for_function("document.title")
            assert tab.title() == "refused"
        page.reload()
        page.wait_for_selector("[data-tradeoff]", state="attached")

        stranger = context.new_page()
        assert stranger.goto(base).status == 403
        assert "the command printed" in stranger.inner_text("body")


def test_the_explorer_does_not_start_unprotected(monkeypatch):
    viser = pytest.importorskip("viser", reason="the extra [explore] is not installed")
    from morlax_torch.viewers.explorer import access

    stopped = []

    class OtherServer:
        gui = SimpleNamespace(_gui_input_handle_from_uuid={})

        def __init__(self, host: str, port: int, verbose: bool):
            pass

        def stop(self) -> None:
            stopped.append(True)

    monkeypatch.setattr(viser, "ViserServer", OtherServer)
    with pytest.raises(MorlaxError, match="would let any web page steer the robot"):
        access.start("127.0.0.1", 0)
    assert stopped


FORWARD = "m/s forward"


def test_only_values_that_the_page_offers_are_accepted(address):
    client, other = Client(address), Client(address)
    slider, text, button, box = map(client.uuid, ("pace", "trade-off", "robot", "velocity"))
    client.set("trade-off", "1, 1, 1, 1, 1, 1")
    other.until(lambda: 'data-tradeoff="0.167, ' in other.html(), "typing has no effect")

    for raw in (b"", b"\xc1", b"\x00" * 1000, b"\x91" * 60_000, "text", '{"type": 1}', "\0"):
        client.send_bytes(raw)
    client.send("ShareUrlRequest")  # would publish the page on the internet
    client.send("NoSuchMessage", uuid=slider)
    client.send("ViewerCameraMessage", **{**POSE, "position": "here"})
    client.send("ViewerCameraMessage", **{**POSE, "fov": math.nan})
    client.send("GuiUpdateMessage", uuid="unknown", updates={"value": 1.0})
    client.send("GuiUpdateMessage", uuid=["a list"], updates={"value": 1.0})
    for updates in ({}, None, {"removed": True}, {"gui_api": None}, {"update_cb": []}):
        client.send("GuiUpdateMessage", uuid=slider, updates=updates)
    for uuid in (slider, text, button):
        for value in (None, True, [], [1.0], {}, {"a": 1}, b"bytes", math.nan, math.inf, -math.inf):
            client.send("GuiUpdateMessage", uuid=uuid, updates={"value": value})
    for value in (None, 0, 1, 1.0, "true", "", [True], math.nan):
        client.send("GuiUpdateMessage", uuid=box, updates={"value": value})
    for label in ("pace", "joints", FORWARD):
        client.set(label, "0.5")
    offered = ("policy", "checkpoint", "robot", "compare", "steer robot", "maximize", "x axis")
    for label in offered:
        for value in (0, "", "secret", "../secret", "/etc/passwd", "x" * 5000, "a\0b"):
            client.set(label, value)
    for typed in ("", "1", "1, nan", "inf, 1, 1, 1, 1, 1", "1, " * 20_000, "1" * 300):
        client.set("trade-off", typed)

    # nobody was disconnected, nothing has changed, and the robot still moves
    moments = {other.html()}
    other.until(lambda: moments.add(other.html()) or len(moments) > 5, "the robot stands still")
    assert other.value("policy") == "runs/bruce/a"
    assert other.value("pace") == 1
    assert other.value("velocity") is False and other.value("x axis") == "joints"
    assert f'data-tradeoff="{", ".join(["0.167"] * 6)}"' in other.html()
    assert client.notifications == other.notifications == []

    # numbers are clamped to the limits of their slider
    limits = other.widgets[other.uuid(FORWARD)]
    for label, value, expected in (
        *(("pace", value, 0.05) for value in (0, -1, -1e300, 5e-324)),
        ("pace", 1e300, 1),
        (FORWARD, 1e9, limits["max"]),
        (FORWARD, -7, limits["min"]),
    ):
        client.set(label, 0.1)
        other.until(partial(has, other, label, 0.1), f"{label} does not change")
        client.set(label, value)
        other.until(partial(has, other, label, expected), f"{label} is not clamped")
    client.set("velocity", True)
    other.until(partial(has, other, "velocity", True), "the checkbox has no effect")


def test_robots_are_added_named_and_removed(address):
    client = Client(address)
    assert client.names() == []
    client.set("compare", "add a robot")
    client.until(lambda: len(client.names()) == 2, "there is no second robot")
    client.set("trade-off", "0, 0, 0, 0, 0, 1")
    client.until(lambda: client.names()[-1] == "▸ 2: energy 1.00", "it is not steered")
    client.until(lambda: client.html().count("<b>robot ") == 2, "their returns are not shown")
    client.set("steer robot", "1")
    client.until(lambda: client.names()[0].startswith("▸ 1"), "the first is not selected")
    client.until(lambda: client.value("energy") == 0.17, "the sliders do not follow")
    client.set("compare", "remove")
    client.until(lambda: client.names() == [], "it is not removed")
    client.until(lambda: client.value("energy") == 1, "the sliders do not follow")
    client.set("dark page", True)
    client.set("contact forces", True)
    client.until(lambda: client.dark, "the page is not dark")
    before = client.moves
    client.until(lambda: client.moves > before + 20, "the robot stands still")


def has(client: Client, label: str, value: float) -> bool:
    return client.value(label) == value


FRAGILE = """
from pathlib import Path
from morlax_torch.envs.robots.planar import Hopper
class Robot(Hopper):
    model_file = {model!r}
    def apply(self, action):
        if Path("broken").exists():
            raise RuntimeError("a joint broke")
        super().apply(action)
"""


@pytest.mark.slow
def test_an_error_in_the_robot_s_code_pauses_it(tmp_path, monkeypatch, make_policy, make_run):
    monkeypatch.chdir(tmp_path)
    damaged = make_run(tmp_path / "runs/hopper/b", "hopper", "best") / "checkpoints/best.pt"
    model = Path(sys.modules[envs.get("hopper").__module__].__file__).parent / "assets/hopper.xml"
    (tmp_path / "robot.py").write_text(FRAGILE.format(model=str(model)))
    policy = make_policy("hopper", network={"actor": [8]})
    object.__setattr__(policy.config, "env", f"{tmp_path}/robot.py:Robot")
    (tmp_path / "run/checkpoints").mkdir(parents=True)
    save(policy, tmp_path / "run/checkpoints/best.pt")
    with exploring("run", "--trust") as (address, process):
        client = Client(address)
        (tmp_path / "broken").touch()
        client.until(lambda: bool(client.notifications), "there is no notification")
        assert set(client.notifications) == {"RuntimeError: a joint broke"}
        later = Client(address)  # also learns why the robot stands still
        later.until(lambda: bool(later.notifications), "there is no notification")
        assert later.notifications == client.notifications[:1]
        later.close()
        buttons = client.widgets[client.uuid("robot")]
        client.until(lambda: "resume" in buttons["options"], "the robot is not paused")
        (tmp_path / "broken").unlink()
        client.set("robot", "resume")
        moments: set[str] = set()
        client.until(lambda: moments.add(client.html()) or len(moments) > 5, "it stands still")

        # a run that cannot be shown is a notification, too
        shown = client.value("policy")
        damaged.write_bytes(b"not a checkpoint")
        client.set("policy", "runs/hopper/b")
        client.until(lambda: "best.pt is damaged" in client.notifications[-1], "no notification")
        client.until(lambda: client.value("policy") == shown, "the dropdown is wrong")
        assert ended(process).count("RuntimeError: a joint broke") == 1
