"""The explorer's server: who may use it, and what it does with input that no page would send."""

import errno
import math
import signal
import socket
import time
import urllib.error
import urllib.request
from collections.abc import Iterator

import pytest
from browsing import PATIENCE, Client, addressed, awaited, exploring, started
from programs import Program
from tiny import TYPED


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


def ended(process: Program) -> str:
    """Stop a server that must still be running, and return what it wrote to stderr."""
    process.send_signal(signal.SIGINT)
    status, _, errors = process.ended(PATIENCE)
    assert status == 0
    return errors


def request(address: str, **headers: str) -> tuple[int, str]:
    try:
        with urllib.request.urlopen(urllib.request.Request(address, headers=headers)) as page:
            return page.status, page.read().decode()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read().decode()


def refuses(address: str) -> bool:
    """Whether nothing listens there; connecting asks no answer of a server that is about to end."""
    host, port = address.removeprefix("http://").split("/")[0].split(":")
    with socket.socket() as client:
        return client.connect_ex((host, int(port))) == errno.ECONNREFUSED


def test_only_the_printed_address_opens_the_page(address):
    from websockets.exceptions import InvalidStatus

    base, token, _ = address.rsplit("/", 2)
    host = base.removeprefix("http://")
    assert len(token) >= 32
    outside = (base, f"{base}/", f"{base}/index.html", f"{base}/{token[:-1]}/", f"{base}/?{token}")
    for wrong in outside:
        status, text = request(wrong)
        assert status == 403
        assert "Open the address that the command printed" in text

    status, page = request(address)
    assert status == 200 and "<html" in page and 'src="main.js"' in page
    assert request(address.rstrip("/")) == (status, page)
    assert request(f"{address}main.js")[0] == 200
    for wrong in ("secret", "../main.js", "engines/../../main.js", "%2e%2e/pyproject.toml"):
        assert request(address + wrong)[0] == 404
    assert request(address, Host=host.replace("127.0.0.1", "localhost"))[0] == 200
    for headers in ({"Host": f"rebound.example:{host.rpartition(':')[2]}"}, {"Origin": "null"}):
        assert request(address, **headers)[0] == 403

    # websockets: without the token, or from another page
    Client(address, {"Origin": base}).close()
    for wrong, origin in (
        (f"{base}/", base),
        (f"{base}/x/", base),
        (address, "http://127.0.0.1:1"),
    ):
        with pytest.raises(InvalidStatus, match="403"):
            Client(wrong, {"Origin": origin})


FORWARD = 0  # index of a number of the command
ODD = (None, True, [], [1.0], {}, {"a": 1}, "text", math.nan, math.inf, -math.inf)


def test_only_what_the_page_offers_is_accepted(address):
    client, other = Client(address), Client(address)
    client.send("steer", weights=[1, 1, 1, 1, 1, 1])
    other.until(lambda: other.tradeoff() == pytest.approx([1 / 6] * 6), "no effect")

    for raw in (b"", b"\xc1", b"\x00" * 1000, b"[" * 60_000, "text", '{"act": 1}', "\0", "null"):
        client.send_bytes(raw)
    client.send("no such act")
    client.send("steer", weights=[1, 1, 1, 1, 1, 1], extra=1)
    for value in ODD:
        client.send("pace", value=value)
        client.send("tell", index=FORWARD, value=value)
        client.send("tell", index=value, value=0.1)
        client.send("nudge", index=FORWARD, change=value)
        client.send("pause", on=value if value is not True else 1)
        client.send("select", robot=value)
        client.send("require", index=value, level=None)
        client.send("steer", weights=value)
        client.send("steer", weights=[value, 1, 1, 1, 1, 1] if value is not True else [])
        client.send("press", name=value)
    client.send("tell", index=7, value=0.1)
    client.send("tell", index=-1, value=0.1)
    client.send("select", robot=3)
    client.send("require", index=6, level=1.0)
    for weights in ([1], [1] * 7, [0] * 6, [-1, 1, 1, 1, 1, 1], [1e308] * 6, [1] * 10_000):
        client.send("steer", weights=weights)

    # nobody was disconnected, nothing has changed, and the robot still moves
    other.moves()
    assert other.state["pace"] == 1 and other.state["paused"] is False
    assert other.tradeoff() == pytest.approx([1 / 6] * 6)
    assert other.state["choosing"]["levels"] == {} and other.state["run"] == "runs/bruce/a"
    assert client.told == other.told == []

    # runs and checkpoints by a name that the page does not list are not opened
    for name in ("secret", "../secret", "/etc/passwd", "x" * 300, "a\0b"):
        client.send("open", run=name, checkpoint=None)
        client.send("open", run="runs/bruce/a", checkpoint=name)
    client.send("pace", value=0.5)
    other.until(lambda: other.state["pace"] == 0.5, "the page hangs")
    assert other.state["run"] == "runs/bruce/a" and other.state["checkpoint"] == "best"

    # numbers are clamped to the limits of their slider
    low, high = list(other.about["command"]["limits"].values())[FORWARD]
    for value, expected in ((0, 0.05), (-1e300, 0.05), (5e-324, 0.05), (1e300, 1)):
        client.send("pace", value=0.5)
        client.send("pace", value=value)
        other.until(lambda e=expected: other.state["pace"] == e, "the pace is not clamped")
    for value, expected in ((1e9, high), (-7, low)):
        client.send("tell", index=FORWARD, value=value)
        other.until(lambda e=expected: other.state["command"][FORWARD] == e, "not clamped")
    client.send("tell", index=FORWARD, value=0.1)
    other.until(lambda: other.state["command"][FORWARD] == 0.1, "no effect")
    for _ in range(8):  # keys count, however late the answer is
        client.send("nudge", index=FORWARD, change=-0.01)
    other.until(lambda: other.state["command"][FORWARD] == pytest.approx(0.02), "a key is lost")
    client.send("nudge", index=FORWARD, change=1e9)
    other.until(lambda: other.state["command"][FORWARD] == high, "not clamped")
    client.close()
    other.close()


@pytest.mark.slow
def test_ctrl_c_does_not_wait_for_clients_that_do_not_read(workplace, make_run):
    make_run(workplace / "run", "hopper", "best")
    with exploring("run") as (address, process):
        host, port = address.removeprefix("http://").split("/")[0].split(":")
        upgrade = "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13"
        path = address.partition(port)[2]
        clients = [socket.socket() for _ in range(2)]
        for client, most in zip(clients, (2**22, 2**11), strict=True):  # a small one is soon full
            client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, most)
            client.connect((host, int(port)))
            key = "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA=="
            head = f"GET {path}socket HTTP/1.1\r\nHost: {host}:{port}\r\n{upgrade}\r\n{key}\r\n\r\n"
            client.sendall(head.encode())
            client.recv(1)
        clients.append(socket.create_connection((host, int(port))))  # and never asks
        reading = Client(address)
        reading.until(lambda: reading.frames > 20, "no frames")
        process.send_signal(signal.SIGINT)
        process.ended(8)  # about one second; websockets alone takes 10 to 20
        for client in clients:
            client.close()


@pytest.mark.slow
def test_a_page_beside_training_follows_it_and_ends_with_it(workplace):
    words = ("train", "--env", "hopper", *TYPED[:-2], "--evaluation.every", "3200", "--explore")
    with started(*words) as process:
        client = Client(address := addressed(process))
        client.until(lambda: len(client.state["training"]) > 1, "the growth is not shown")
        before = client.state["training"][-1]
        client.until(lambda: client.state["training"][-1] != before, "training is not followed")
        assert client.state["checkpoint"] == "latest"
        assert client.state["front"]["fingerprint"] == client.state["training"][-1]["fingerprint"]
        client.moves()
        client.close()
        process.send_signal(signal.SIGINT)
        status, output, errors = process.ended(PATIENCE)
        assert status == 130 and "interrupted" in output and errors == ""
        for _ in range(10 * PATIENCE):
            if refuses(address):
                break
            time.sleep(0.1)
        else:
            pytest.fail("the page did not end with its training")


@pytest.mark.slow
def test_a_page_beside_training_stays_until_ctrl_c(workplace):
    with started("train", "--env", "hopper", *TYPED, "--explore") as process:
        awaited(process, "the page stays open")
        client = Client(addressed(process))
        client.moves()
        client.close()
        assert ended(process) == ""


FRAGILE = """
from pathlib import Path
from morlax_torch import envs
class Robot(envs.get("hopper")):
    def apply(self, action):
        if Path("broken").exists():
            raise RuntimeError("a joint broke")
        super().apply(action)
"""


@pytest.mark.slow
def test_an_error_in_the_robot_s_code_pauses_it(workplace, make_run):
    damaged = make_run(workplace / "runs/hopper/b", "hopper", "best") / "checkpoints/best.pt"
    (workplace / "robot.py").write_text(FRAGILE)
    make_run(workplace / "run", "hopper", "best", env=f"{workplace}/robot.py:Robot")
    with exploring("run", "--trust") as (address, process):
        client = Client(address)
        (workplace / "broken").touch()
        client.until(lambda: bool(client.told), "nothing is told")
        assert set(client.told) == {"RuntimeError: a joint broke"}
        client.until(lambda: client.state["paused"], "the robot is not paused")
        later = Client(address)  # also learns why the robot stands still
        assert later.state["failure"] == client.told[0]
        later.close()
        (workplace / "broken").unlink()
        client.send("pause", on=False)
        client.moves()

        # a run that cannot be shown is told, too, and the robot stays
        damaged.write_bytes(b"not a checkpoint")
        client.send("open", run="runs/hopper/b", checkpoint=None)
        client.until(lambda: "best.pt is damaged" in client.told[-1], "nothing is told")
        assert client.state["run"] == "run"
        client.moves()
        client.close()
        assert ended(process).count("RuntimeError: a joint broke") == 1
