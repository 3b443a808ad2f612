"""The explorer's page: errors of the command, and its behavior in a real browser."""

import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import matplotlib.pyplot as plt
import mujoco
import numpy as np
import pytest
from browsing import PATIENCE, View, chromium, exploring, needs_page
from growing import grow, train_on
from matplotlib.colors import to_rgb
from programs import Program
from tiny import TYPED

from morlax_torch.commands import explore, train
from morlax_torch.configuration.schedules import Schedule
from morlax_torch.evaluation.front import Front
from morlax_torch.runs import loading


def test_an_address_that_cannot_be_listened_on_is_an_error(workplace, make_run, refused):
    needs_page()
    from morlax_torch.viewers.explorer.server import listening

    make_run(workplace / "run", "hopper", "best")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with listening("127.0.0.1", port) as other:
            assert port < other.getsockname()[1] < port + 20
    assert "from 0 to 65535" in refused(explore, "run", "--port", "70000")
    for host in ("192.0.2.1", "..", "a" * 70, "é..", "a\0b"):
        text = refused(explore, "run", "--host", host)
        assert "cannot listen on" in text and "choose another --port or --host" in text


def test_with_old_websockets_the_error_names_the_extra(workplace, make_run, monkeypatch, refused):
    make_run(workplace / "run", "hopper", "best")
    for name in ("page", "server"):
        monkeypatch.delitem(sys.modules, f"morlax_torch.viewers.explorer.{name}", raising=False)
    monkeypatch.setattr("importlib.metadata.version", {"websockets": "13.1"}.__getitem__)
    tried = (explore, "run", "--port", "0"), (train, "--env", "hopper", *TYPED, "--explore")
    for words in tried:
        message = refused(*words)
        assert "websockets 14 or later is needed, but 13.1 is installed" in message
        assert "pip install 'morlax-torch[explore]'" in message


WAITING = """
import signal, threading, time
from queue import Queue
from morlax_torch.viewers.explorer.page import drained

def interrupt(thread):
    while True:
        time.sleep(0.003)
        signal.pthread_kill(thread, signal.SIGINT)

def keep_busy():
    while True:
        sum(range(2000))

signal.signal(signal.SIGINT, lambda number, frame: None)
threading.Thread(target=keep_busy, daemon=True).start()
threading.Thread(target=interrupt, args=(threading.get_ident(),), daemon=True).start()
queue = Queue()
for _ in range(200):
    drained(queue, 0.002)
"""


def test_the_wait_for_requests_ends_whenever_a_signal_comes():
    subprocess.run([sys.executable, "-c", WAITING], timeout=PATIENCE, check=True)


LONG = "a-long-name-of-an-experiment"


@pytest.fixture(scope="module")
def served(tmp_path_factory, make_run) -> Iterator[tuple[str, Program]]:
    """Serve a run with three objectives; others lie beside it. Yields address and process."""
    place = tmp_path_factory.mktemp("served")
    grow(make_run(place / "runs/cheetah3/a", "cheetah3", "best", "latest"))
    make_run(place / "runs/hopper/b", "hopper", "best")
    make_run(place / "runs/bruce/c", "bruce", "best")
    grow(make_run(place / "runs/hopper/grows", "hopper", "best"))
    make_run(place / "runs/bare", "hopper", "best")
    (place / "runs/bare/front.npz").unlink()
    broken = make_run(place / f"runs/{LONG}/20261120-054533-0", "hopper", "best")
    (broken / "checkpoints/best.pt").write_bytes(b"not a checkpoint")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        with exploring("runs/cheetah3/a") as served:
            yield served


@pytest.fixture(scope="module")
def browser() -> Iterator:
    with chromium() as browser:
        yield browser


@pytest.fixture
def visit(served, browser) -> Iterator:
    """Return a function that opens a tab; no tab may have an error or ask another site."""
    views: list[View] = []

    def open_tab(*size: int) -> View:
        views.append(View(browser, served[0], *size))
        return views[-1]

    yield open_tab
    for view in views:
        assert view.errors == [] and view.elsewhere == []
        if not view.tab.is_closed():
            assert view.tab.is_hidden("#problem")
        view.tab.close()


def show(view: View, run: str, objectives: int) -> None:
    view.tab.select_option("#run", run)
    view.until(lambda: view.tab.locator("#weights input").count() == objectives, "not shown")
    view.until(lambda: len(view.tradeoff()) == objectives, "not shown")


@pytest.mark.slow
def test_a_browser_steers_the_robot(visit):
    view = visit()
    assert view.tab.title() == "cheetah3 · morlax"
    view.moves()
    view.press("balance")
    view.until(lambda: view.tradeoff() == pytest.approx((1 / 3,) * 3, abs=1e-3), "no balance")

    # drag a slider: the other weights shrink in proportion
    run = view.drag("run", 0.8)
    view.until(lambda: view.tradeoff()[0] == pytest.approx(run, abs=1e-3), "slider has no effect")
    first, *others = view.tradeoff()
    assert others == pytest.approx([(1 - first) / 2] * 2, abs=2e-3)
    view.until(
        lambda: view.value("energy saved") == pytest.approx(others[0], abs=6e-3), "they differ"
    )

    # keys work while a slider or a button has the focus, which keeps its own keys
    slider, timeline = view.slider("energy saved"), view.tab.locator("#timeline")
    slider.focus()
    slider.press("Space")
    view.until(timeline.is_visible, "the key has no effect while a slider has the focus")
    before = view.value("energy saved")
    slider.press("ArrowRight")
    view.until(lambda: view.value("energy saved") > before, "the slider loses its key")
    view.press("balance")
    view.tab.keyboard.press("Space")
    view.until(timeline.is_hidden, "the key has no effect after a click on a button")
    view.tab.click("#show-section summary")
    view.tab.get_by_text("velocity", exact=True).click()
    view.tab.keyboard.press("Space")
    view.until(timeline.is_visible, "the key has no effect after a click on a checkbox")
    view.tab.keyboard.press("Space")
    view.tab.focus("#push")
    view.tab.keyboard.press("r")
    view.until(lambda: view.clock() < 0.5, "the key has no effect while a button has the focus")

    # type a trade-off; nonsense changes nothing
    view.tab.fill("#typed", "3; 1, 0")
    view.until(lambda: view.value("run") == 0.75, "typing has no effect")
    for text in ("0.7", "-1, 2, 0", "0, 0, 0", "nan, 1, 1", "Infinity, 1, 1", "run"):
        view.tab.fill("#typed", text)
        told = (
            "Type 3 weights, none negative, for run, energy saved, height: such as "
            "0.333, 0.333, 0.333."
        )
        assert view.text("mistyped") == told
    view.tab.evaluate("navigator.clipboard.writeText = async (text) => (self.copied = text)")
    view.press("copy")
    view.until(lambda: view.tab.evaluate("self.copied") == "0.75, 0.25, 0", "nonsense is copied")
    view.until(lambda: view.text("mistyped") == "", "a mistake is still told")
    assert view.value("run") == 0.75 and view.value("energy saved") == 0.25
    view.tab.fill("#typed", "1, 2, 4")
    view.until(lambda: view.value("run") < 0.2, "typing has no effect")
    view.press("copy")  # exactly, as another policy may not keep what is required
    exact = "0.14286, 0.28571, 0.57143"
    view.until(lambda: view.tab.evaluate("self.copied") == exact, "another one is copied")

    # the front: a click picks a policy, and its mark moves there
    view.tab.select_option("#axes select >> nth=0", label="run")
    view.tab.select_option("#axes select >> nth=1", label="energy saved")
    corner = view.tab.locator("#front circle:not(.mark)").nth(1)
    view.tab.mouse.click(*middle(corner))
    view.until(lambda: max(view.tradeoff()) == 1, "the click has no effect")
    told = view.tab.locator("#front .plot").get_attribute("aria-valuetext")
    assert re.fullmatch(r"run per second: .* \(weight \d+ %\), energy saved per second: .*", told)
    mark = view.tab.locator("#front .mark")
    view.until(lambda: middle(mark) == pytest.approx(middle(corner), abs=1), "no mark")

    # drag the point of the triangle, also beyond an edge
    triangle = view.tab.locator("#edge")
    triangle.scroll_into_view_if_needed()
    box = triangle.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"]
    view.tab.mouse.move(x, y - box["height"] / 3)
    view.tab.mouse.down()
    view.until(lambda: view.tradeoff() == pytest.approx((1 / 3,) * 3, abs=0.04), "no drag starts")
    view.tab.mouse.move(x, y + 15)
    view.tab.mouse.up()
    view.until(lambda: view.tradeoff() == pytest.approx((0, 0.5, 0.5), abs=0.04), "no drag ends")
    view.press("energy saved")
    view.until(lambda: view.tradeoff() == (0, 1, 0), "the button has no effect")


MIDDLE = """element => {
    element.scrollIntoView({block: "nearest"});
    const {x, y, width, height} = element.getBoundingClientRect();
    return [x + width / 2, y + height / 2];
}"""


def middle(locator: Any) -> tuple[float, float]:
    """Return the middle of an element, in pixels of its tab; the page may redraw it meanwhile."""
    return tuple(locator.evaluate(MIDDLE))


@pytest.mark.slow
def test_all_tabs_show_the_same_robot_which_can_be_paused_and_replaced(visit):
    first, phone = visit(), visit(390, 844)
    first.tab.fill("#typed", "1, 3, 0")
    phone.until(lambda: phone.tradeoff() == (0.25, 0.75, 0), "the other tab does not follow")
    phone.press("energy saved")  # while the first tab's field still has the focus
    first.until(lambda: first.field() == "0, 1, 0", "the field does not follow")

    # a slider stays under the hand while another tab steers; its tab closes in the middle of a drag
    box = first.slider("run").bounding_box()
    first.tab.mouse.move(box["x"] + 10, box["y"] + box["height"] / 2)
    first.tab.mouse.down()
    first.until(lambda: first.value("run") < 0.1, "the slider does not follow")
    phone.tab.fill("#typed", "1, 1, 0")
    first.until(lambda: first.tradeoff() == (0.5, 0.5, 0), "the first tab does not follow")
    assert first.value("run") < 0.1
    first.tab.close()
    third = visit()
    third.moves()

    third.tab.click("#pause")
    phone.until(lambda: phone.tab.is_visible("#timeline"), "the other tab is not paused")
    phone.tab.wait_for_timeout(300)
    before = phone.clock()
    phone.tab.wait_for_timeout(500)
    assert phone.clock() == before
    third.tab.click("#push")
    for view in (third, phone):
        view.tab.press("#timeline", "Home")  # looks back
    third.tab.click("#reset")
    third.until(lambda: third.clock() == 0, "the episode is not reset")
    third.tab.click("#pause")
    third.moves()
    phone.moves()

    # the lists say what is shown, also after another run could not be opened
    broken = f"runs/{LONG}/20261120-054533-0"
    assert third.tab.inner_text(f"#run option[value='{broken}']") == "…/20261120-054533-0"
    third.tab.select_option("#run", broken)
    third.tab.emulate_media(reduced_motion="reduce")
    third.until(lambda: "best.pt is damaged" in third.text("event"), "nothing is said")
    assert third.tab.evaluate("getComputedStyle(document.getElementById('event')).opacity") == "1"
    third.until(lambda: third.tab.input_value("#run") == "runs/cheetah3/a", "another run's name")
    lacking = third.tab.locator("#run option[value=go1]")
    assert lacking.is_disabled() == (find_spec("mjlab") is None)
    assert lacking.inner_text() == "go1 (needs mjlab)" or lacking.is_enabled()

    # other runs: with two objectives, and with six and a velocity command
    show(third, "runs/hopper/b", 2)
    assert third.value("run") + third.value("jump") == pytest.approx(1, abs=6e-3)
    phone.until(lambda: phone.tab.title() == "hopper · morlax", "the other tab shows the old run")
    show(third, "runs/bruce/c", 6)
    assert third.value("m/s forward") == 0.12 and third.value("m/s to the left") == 0
    assert third.value("smoothness") == pytest.approx(1 / 6, abs=5e-3)
    third.drag("m/s to the left", 1.0)
    limit = float(third.slider("m/s to the left").get_attribute("max"))
    phone.until(lambda: phone.value("m/s to the left") == pytest.approx(limit, abs=1e-3), "no")

    third.tab.evaluate("document.activeElement.blur()")
    third.tab.keyboard.press("x")
    phone.until(lambda: phone.value("m/s forward") == 0, "the robot is not stopped")
    show(third, "runs/cheetah3/a", 3)
    for name in ("latest", "best"):
        third.tab.select_option("#checkpoint-list", name)
        phone.until(lambda n=name: phone.tab.input_value("#checkpoint-list") == n, "the old one")


@pytest.mark.slow
def test_the_page_looks_back_on_training_and_follows_it_without_a_reload(visit):
    view = visit()
    scrubber = view.tab.get_by_role("slider", name="Training", exact=True)
    scrubber.focus()
    scrubber.press("ArrowLeft")
    said = "10 s, 1k steps: hypervolume 6k"
    view.until(lambda: view.text("moment-told") == said, "the scrubber has no effect")
    assert scrubber.get_attribute("aria-valuetext") == said
    past = view.tab.locator("#front .looks-back g circle:not(.mark)")
    view.until(lambda: past.count() > 0, "the earlier front is not shown")
    scrubber.press("End")
    view.until(lambda: past.count() == 0, "the page does not return to the present")
    assert view.tab.locator("#front .earlier").count() == 2
    view.press("play")
    view.until(lambda: past.count() > 0, "the front does not grow")
    view.press("stop")

    # a newer checkpoint replaces policies and front, but neither the robot nor what has the focus
    show(view, "runs/hopper/grows", 2)
    view.press("per episode")
    view.press("run")
    evaluated = view.tab.locator("#episode tr", has_text="run").locator("td").last
    view.until(lambda: evaluated.inner_text() == "110", "no evaluated return")
    view.tab.focus("#typed")
    view.tab.evaluate("self.mine = () => {}")
    policy = loading.load("runs/hopper/grows")
    policy.agent.actor.bias.data += 0.1
    train_on(Path("runs/hopper/grows"), policy)
    view.until(lambda: evaluated.inner_text() == "111", "no new front")
    assert view.tab.evaluate("[typeof mine, document.activeElement.id]") == ["function", "typed"]
    view.press("per second")
    show(view, "runs/cheetah3/a", 3)


@pytest.mark.slow
def test_axe_finds_no_barrier(visit):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    view = visit(1440, 900)
    view.tab.wait_for_selector("#moment")
    view.tab.evaluate("document.querySelectorAll('details').forEach(part => part.open = true)")
    for width, height in ((1440, 900), (390, 844)):
        view.tab.set_viewport_size({"width": width, "height": height})
        for _ in ("light", "dark"):
            found = axe.run(view.tab)
            assert found.violations_count == 0, found.generate_report()
            view.tab.evaluate("document.getElementById('theme').click()")


@pytest.mark.slow
def test_a_picture_and_a_clip_are_saved_with_the_names_of_the_robots(visit, tmp_path):
    view = visit()
    show(view, "runs/cheetah3/a", 3)
    view.tab.get_by_role("button", name="add a robot").press("Enter")
    view.until(lambda: len(view.names()) == 2, "no second robot")
    assert view.tab.evaluate("document.activeElement.textContent") == "add a robot"
    with view.tab.expect_download() as photo:
        view.tab.click("#photo")
    assert photo.value.suggested_filename.startswith("cheetah3 ")
    photo.value.save_as(tmp_path / "photo.png")
    image = plt.imread(tmp_path / "photo.png")[..., :3]
    rings = image.shape[0] // 2  # the names are above the robots
    for color in ("#7048e8", "#0b7285"):
        assert np.abs(image[:rings] - to_rgb(color)).max(-1).min() < 0.2

    view.tab.click("#clip")
    for _ in range(5):  # a busy browser records only some of the frames
        view.moves()
    with view.tab.expect_download() as clip:
        view.tab.click("#clip")
    file = tmp_path / clip.value.suggested_filename
    clip.value.save_as(file)
    ffmpeg = imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-i", file, "-f", "framemd5", "-"
    lines = subprocess.run(ffmpeg, capture_output=True, check=True, text=True).stdout.splitlines()
    assert len({line.split(",")[-1] for line in lines if not line.startswith("#")}) > 1
    view.press("remove")


def name_bookmark(view: View, button: str, name: str) -> None:
    view.press(button)
    view.tab.fill("#bookmark-name", name)
    view.press("save")
    view.tab.get_by_role("button", name=f"@{name}").wait_for()


@pytest.mark.slow
def test_a_bookmark_is_kept_with_the_run(visit, served):
    view = visit()
    show(view, "runs/hopper/b", 2)
    view.tab.fill("#typed", "0.4, 0.6")
    view.until(lambda: view.value("run") == 0.4, "typing has no effect")
    view.press("keep")
    view.tab.keyboard.type("calm")
    view.tab.keyboard.press("Enter")
    view.tab.get_by_role("button", name="@calm").wait_for()
    view.press("run")
    view.until(lambda: view.tradeoff() == (1, 0), "the button has no effect")
    view.press("@calm")
    view.until(lambda: view.tradeoff() == (0.4, 0.6), "the bookmark has no effect")
    file = Path("runs/hopper/b/bookmarks.yaml")
    assert file.read_text() == "calm: [0.4, 0.6]\n"
    assert view.tab.locator("#front .pin-name").all_text_contents() == ["@calm"]

    # renamed and deleted in place
    name_bookmark(view, "Rename calm", "slow")
    assert file.read_text() == "slow: [0.4, 0.6]\n"
    view.press("Delete slow")
    view.until(lambda: view.tab.locator("#bookmarks button").count() == 0, "it is not deleted")
    name_bookmark(view, "keep", "calm")
    view.press("keep")
    view.tab.keyboard.type("calm")
    view.tab.keyboard.press("Enter")
    view.until(lambda: "bookmark calm already" in view.text("event"), "a taken name is kept")
    assert view.tab.input_value("#bookmark-name") == "calm"
    assert view.tab.is_visible("#naming")
    view.press("cancel")

    # a talk: the robot alone, bookmarks as stops
    view.tab.fill("#typed", "1, 0")
    view.until(lambda: view.value("run") == 1, "typing has no effect")
    name_bookmark(view, "keep", "fast")
    view.tab.click("#talk")
    caption = "calm\nrun 40 %, jump 60 %"
    view.until(lambda: view.text("caption") == caption, "the talk does not begin")
    assert view.tab.is_hidden("#panel")
    view.tab.keyboard.press("ArrowRight")
    view.until(lambda: view.text("caption").startswith("fast"), "there is no next stop")
    for _ in range(2):
        view.tab.keyboard.press("ArrowLeft")
    view.until(lambda: view.text("caption").startswith("calm"), "there is no former stop")
    view.tab.keyboard.press("Escape")
    view.until(lambda: view.tab.is_visible("#panel"), "the talk does not end")
    view.until(lambda: view.tradeoff() == (0.4, 0.6), "the talk has not steered")


@pytest.mark.slow
def test_a_browser_finds_the_preferred_tradeoff(visit):
    view = visit()
    front = Front.load(loading.find_run("cheetah") / "front.npz")
    show(view, "cheetah", 2)

    view.press("A or B?")
    view.until(lambda: view.names() == ["A", "B"], "A and B have no names")
    for number in range(9):
        text = f"Answers so far: {number}"
        view.until(lambda t=text: view.text("question").endswith(t), "no next question")
        view.until(lambda: view.tab.locator("#front .mark").count() == 2, "not marked")
        assert view.tab.is_hidden("#weights")
        a, b = view.tab.evaluate(STATED)
        view.press("A" if a[0] > b[0] else "B")  # this user likes speed
    view.until(lambda: view.text("question").endswith("so far: 9"), "no effect")
    assert re.match(r"You preferred [AB]. A: run per second .*; B: run per", view.text("told"))
    assert re.search(r"\d+ % sure", view.text("evidence"))
    standing = view.tab.locator("#front circle:not(.out):not(.mark)").count()
    assert 0 < standing < len(front.returns) / 2  # what is still possible
    view.press("use this trade-off")
    view.until(lambda: view.names() == [], "the mode does not end")
    nearest = np.square(front.tradeoffs - view.tradeoff()).sum(1).argmin()
    run = front.returns[front.non_dominated, 0]
    assert front.returns[nearest, 0] > run.max() - 0.02 * np.ptp(run)


# the trade-offs that the server says the robots have
STATED = """async () => {
  const { Remote } = await import(new URL('engines/remote.js', location));
  const nothing = { step() {}, tell() {}, lost() {}, renew() {} };
  const remote = await Remote.connect(nothing);
  const found = remote.robots.map(({ tradeoff }) => tradeoff);
  remote.socket.onclose = null;
  remote.socket.close();
  return found;
}"""


def run_in(view: View, script: str, *given: Any) -> Any:
    """Run the body of an async function with `load(path)`, for the page's modules, and `given`."""
    return view.tab.evaluate(
        "async ([given, body]) => {"
        " const load = (path) => import(new URL(path, location));"
        " const Async = (async () => {}).constructor;"
        " return new Async('load', 'given', body)(load, given); }",
        [list(given), script],
    )


def plain(model: mujoco.MjModel) -> dict[str, Any]:
    """Return what the page needs of a model's geoms and bodies, as plain numbers."""
    names = [name for name in dir(model) if name.startswith(("geom_", "mesh_"))]
    arrays = {name: getattr(model, name) for name in names}
    numbers = {k: v.ravel().tolist() for k, v in arrays.items() if isinstance(v, np.ndarray)}
    return {"ngeom": model.ngeom, "nbody": model.nbody, **numbers}


SHAPES = """
<mujoco><asset><mesh name="m" vertex="0 0 0  .3 0 0  0 .3 0  0 0 .3"/></asset><worldbody>
  <geom type="sphere" size=".2"/><geom type="capsule" size=".1 .3"/>
  <geom type="cylinder" size=".1 .3"/><geom type="box" size=".1 .2 .3"/>
  <geom type="ellipsoid" size=".1 .2 .3"/><geom type="mesh" mesh="m"/>
  <geom type="plane" size="1 1 1"/>
</worldbody></mujoco>
"""
MEASURE = """
  const { geometryOf } = await load('stage/shapes.js');
  const THREE = await import('three');
  const [model] = given;
  for (const [name, x] of Object.entries(model)) {
    if (Array.isArray(x)) model[name] = Float64Array.from(x);
  }
  return Array.from({ length: model.ngeom }, (_, geom) => {
    const geometry = geometryOf(model, geom)?.toNonIndexed();
    if (!geometry) return null;
    geometry.computeBoundingBox();
    const { min, max } = geometry.boundingBox;
    const points = geometry.getAttribute('position');
    const corner = (i) => new THREE.Vector3().fromBufferAttribute(points, i);
    let volume = 0;
    for (let i = 0; i < points.count; i += 3) {
      volume += corner(i).dot(corner(i + 1).cross(corner(i + 2))) / 6;
    }
    return { volume, low: min.toArray(), high: max.toArray() };
  });"""


@pytest.mark.slow
def test_shapes_match_mujoco_volumes_and_bounds(visit):
    model = mujoco.MjModel.from_xml_string(SHAPES)
    found = run_in(visit(), MEASURE, plain(model))
    pi = np.pi
    volumes = [
        4 / 3 * pi * 0.2**3,
        4 / 3 * pi * 0.1**3 + pi * 0.1**2 * 0.6,
        pi * 0.1**2 * 0.6,
        0.2 * 0.4 * 0.6,
        4 / 3 * pi * 0.1 * 0.2 * 0.3,
        0.3**3 / 6,
    ]
    for geom, volume in enumerate(volumes):
        assert found[geom]["volume"] == pytest.approx(volume, rel=0.03)
        center, half = model.geom_aabb[geom].reshape(2, 3)
        bounds = [found[geom]["low"], found[geom]["high"]]
        np.testing.assert_allclose(bounds, [center - half, center + half], atol=5e-3)
    assert found[len(volumes)] is None


TINTED = """
  const { Robot } = await load('stage/robot.js');
  const [model, shifts, shown] = given;
  for (const [name, x] of Object.entries(model)) {
    if (Array.isArray(x)) model[name] = Float64Array.from(x);
  }
  const robot = new Robot(model, 1, null);
  const turns = new Float32Array(4 * shifts.length);
  const at = (xs) => ({ places: Float32Array.from(xs.flatMap((x) => [x, 0, 0])), turns });
  const pose = { ...at(shifts.map(() => 0)), ghost: at(shifts) };
  return shown.map((names) => {
    robot.pose(pose, pose, 1, new Set(names));
    const geoms = robot.bodies.flatMap(({ children }) => children);
    const colors = geoms.map(({ material }) => material.color.getHexString());
    return [colors, robot.ghost.map(({ visible }) => visible)];
  });"""


@pytest.mark.slow
def test_bodies_show_by_color_how_far_they_are_from_the_motion(visit):
    body = '<body><geom size=".1" rgba="1 1 1 1"/></body>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{5 * body}</worldbody></mujoco>")
    shown = ["ghost", "errors"]
    shifts = [0, 0, 0.05, 0.1, 0.15, 9]  # m
    looks = run_in(visit(), TINTED, plain(model), shifts, [shown, shown[:1], shown[1:]])
    (colors, seen), (bare, still), (hidden, unseen) = looks
    greens = [int(color[2:4], 16) for color in colors]
    assert greens[0] == 255 and greens[3] == greens[4] and greens == sorted(greens, reverse=True)
    assert len(set(greens)) == 4
    assert bare == hidden == ["ffffff"] * 5
    assert all(seen + still) and not any(unseen)


@pytest.mark.slow
def test_sliders_follow_a_trade_off_over_time_and_the_page_tells_the_end_of_its_server(
    browser, workplace, make_run
):
    make_run(workplace / "run", "hopper", "best")
    weights = np.array([[1.0, 0.0], [0.2, 0.8]])
    Schedule(np.array([0.0, 1.5]), weights).save(workplace / "s.yaml", ("run", "jump"))
    with exploring("run", "--tradeoff", "s.yaml") as (address, process):
        view = View(browser, address)
        follow = view.tab.get_by_role("button", name="over time")
        for _ in range(2):
            seen = [view.value("run")]
            view.until(lambda: view.value("run") not in seen, "the sliders stand still")  # noqa: B023
            assert follow.get_attribute("aria-pressed") == "true"
            held = view.drag("run", 0.9)
            view.until(lambda: follow.get_attribute("aria-pressed") == "false", "not taken over")
            view.moves()
            view.moves()
            assert view.value("run") == pytest.approx(held, abs=6e-3)
            follow.click()
        process.send_signal(signal.SIGINT)
        status, output, errors = process.ended(PATIENCE)
        assert status == 0 and errors == ""
        assert output.splitlines()[-1].startswith("open ")
        view.until(lambda: "has stopped" in view.text("event"), "nothing is said")
        view.tab.close()


CHOSEN = """
  const { ChoosingPanel } = await load('panel/choosing.js');
  const front = { returns: [[1, 2], [2, 1]], measured: [], seconds: 2 };
  const about = { objectives: ['a', 'b'], titles: ['A saved', 'b'], front };
  return given[0].map((falls) => {
    const found = { returns: { a: 1.5, b: 2 }, quantities: {}, cost: 1, simulated: 3, falls };
    const choosing = { levels: { 0: 1 }, maximized: 1, searching: false, found, reason: '' };
    new ChoosingPanel({ about, choosing }, () => {}).show();
    const { textContent, dataset } = document.getElementById('found');
    return [textContent, dataset.state, document.getElementById('maximize').textContent];
  });"""


@pytest.mark.slow
def test_a_choice_says_margin_and_cost_and_what_a_fall_means(visit):
    kept, falls = run_in(visit(), CHOSEN, [0, 0.004])
    text = (
        "Best of 3 simulated policies: A saved per second 0.75 (0.25 above the limit), "
        "b per second 1; costs 0.5 of b per second."
    )
    assert kept == [text, "found", "b"]  # what is required cannot be maximized
    broken = (
        " It falls in <1 % of its episodes, which these values include; in these it keeps no "
        "requirement."
    )
    assert falls[:2] == [text + broken, "missed"]


@pytest.mark.slow
def test_a_required_level_is_a_line_that_can_be_dragged_and_its_search_canceled(visit):
    view = visit(1440, 900)
    show(view, "runs/cheetah3/a", 3)
    view.tab.wait_for_selector("#moment")  # earlier fronts widen the plot
    view.tab.click("#choosing-section summary")
    slider = view.slider("at least run")
    slider.focus()
    slider.press("End")
    line = view.tab.locator("#front .threshold")
    view.until(lambda: line.count() == 1, "no line")
    boxes = [view.tab.locator(f"#front {x}").bounding_box() for x in ("#thresholds text", ".plot")]
    assert boxes[0]["x"] + boxes[0]["width"] <= boxes[1]["x"] + boxes[1]["width"]
    before = view.text("levels")
    assert "≥" in before and view.tab.locator("#maximize option").all_inner_texts() == [
        "energy saved",
        "height",
    ]
    x, y = middle(line)
    view.tab.mouse.move(x, y)
    view.tab.mouse.down()
    view.tab.mouse.move(x - 60, y, steps=4)
    view.tab.mouse.up()
    view.until(lambda: view.text("levels") != before, "the line requires nothing else")
    assert middle(line)[0] == pytest.approx(x - 60, abs=3)
    cancel = view.tab.get_by_role("button", name="cancel the search")
    cancel.wait_for()
    cancel.click()
    view.until(lambda: "canceled" in view.text("found"), "the search goes on")
    # the same level in the other unit, a return of the whole episode
    level = float(view.text("levels").split("≥")[1].split()[0].replace("k", "e3"))
    view.tab.keyboard.press("u")
    view.until(lambda: "per episode" in view.text("front"), "the unit stays")

    def seconds() -> float:
        return float(view.text("levels").split("≥")[1].split()[0].replace("k", "e3")) / level

    view.until(lambda: seconds() == pytest.approx(2, rel=0.02), "the level keeps its number")
    view.press("per second")
    view.press("thresholds off")


@pytest.mark.slow
def test_a_newcomer_sees_what_to_do_and_keys_help(visit):
    view = visit(1440, 900)
    show(view, "runs/bruce/c", 6)
    assert view.text("lead").startswith("One network, every trade-off. Drag a slider; each dot is")
    assert view.tab.is_visible("#hint")
    plot = view.tab.locator("#front .plot").bounding_box()
    assert plot["y"] + plot["height"] < 900  # above the fold, also with six objectives
    assert view.tab.locator("#matrix button").count() == 15
    assert "better" in view.text("front") and "on the front" in view.text("legend")
    view.press("smoothness against joint tracking")
    view.until(lambda: "smoothness per second" in view.text("front"), "no other pair")
    view.tab.keyboard.press("?")
    assert view.tab.is_visible("#help") and "restart the episode" in view.text("help")
    view.tab.keyboard.press("Escape")
    slider = view.slider("smoothness")
    slider.focus()
    for _ in range(5):
        slider.press("ArrowRight")
    view.until(lambda: view.tab.is_hidden("#hint"), "the hint stays")
    view.until(lambda: view.tab.locator("#front .between").count() == 1, "the ring says nothing")
    assert "between evaluated policies" in view.text("front")
    slider.press("b")
    view.until(lambda: view.tradeoff() == pytest.approx((1 / 6,) * 6, abs=1e-3), "no letter works")
