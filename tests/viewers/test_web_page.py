"""The web page in Chromium: physics, observations and policies are those of Python."""

import functools
import gzip
import http.server
import json
import re
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
import web_robots
from browsing import COARSE, FEW_FRAMES, PATIENCE, chromium, until
from tiny import tiny

import morlax_torch
from morlax_torch import MorlaxError, envs
from morlax_torch.train import train
from morlax_torch.viewers import libraries
from morlax_torch.viewers.web.writing import build, write_page

pytest.importorskip("onnxscript", reason="the extra [onnx] is not installed")
playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
expect = playwright.expect
expect.set_options(timeout=1000 * PATIENCE)
pytestmark = pytest.mark.slow  # to write the page takes half a minute
STEPS = 100
SIMULATE = """async ([site, folder, controls]) => {
  const { Simulation } = await import(`${site}engines/simulation.js`);
  const { engine, model, data, about } = await Simulation.load(`${site}${folder}`);
  return controls.map((control) => {
    data.ctrl.set(control);
    for (let i = 0; i < about.substeps; i++) engine.mj_step(model, data);
    return Array.from(data.qpos);
  });
}"""
ACT = """async ([site, folder, tradeoff, steps]) => {
  const { Simulation } = await import(`${site}engines/simulation.js`);
  const simulation = await Simulation.load(`${site}${folder}`);
  simulation.tradeoff = tradeoff;
  const found = [];
  for (let i = 0; i < steps; i++) {
    const { action, reward } = await simulation.step();
    const { qpos, qvel, sensordata } = simulation.data;
    const numbers = { action, reward, qpos, qvel, sensordata, observation: simulation.observation };
    const plain = Object.entries(numbers).map(([name, x]) => [name, Array.from(x)]);
    found.push({ ...Object.fromEntries(plain), over: simulation.over });
    if (simulation.over) break;
  }
  return found;
}"""

HELD = """
  const get = fetch;
  globalThis.fetch = async (address, ...rest) => {
    if (String(address).includes("mujoco.wasm")) await new Promise((go) => (globalThis.go = go));
    return get(address, ...rest);
  };
"""
SHOW_AGAIN = """async () => {
  const { Stage } = await import(new URL("stage/stage.js", location));
  const { Recorded } = await import(new URL("engines/recorded.js", location));
  const canvas = document.body.appendChild(document.createElement("canvas"));
  const stage = new Stage(canvas, document.createElement("div"));
  return Promise.all([1, 2, 3].map(async () => {
    stage.show(await Recorded.load("runs/0"));
    stage.draw(1);
    return { ...stage.renderer.info.memory };
  }));
}"""
KEPT = """Promise.all(
  [{ name: location.pathname }, ...performance.getEntriesByType("resource")]
    .map(({ name }) => caches.match(name)),
).then((found) => found.every(Boolean))"""
TARGETS = """() => Object.fromEntries(
  Array.from(document.querySelectorAll("button, select, input, summary"))
    .map((element) => element.closest(".check") ?? element) // all of its line
    .map((element, i) => [`${element.tagName} ${i}`, element.getBoundingClientRect()])
    .filter(([, { width }]) => width)
    .map(([name, { width, height }]) => [name, [width, height]]),
)"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A page with a shipped robot and one of a user, whose policy is untrained."""
    try:
        libraries.files()
    except MorlaxError as error:
        pytest.skip(str(error))
    place = tmp_path_factory.mktemp("web")
    task = f"{web_robots.write(place / 'robots')}:Tumbler"
    envs.trust(task)
    run = train(tiny(task, **{"task.episode_length": 500}), output=place / "run").folder
    write_page(["cheetah3", str(run)], place / "page")
    return place / "page"


@pytest.fixture(scope="module")
def site(folder) -> Iterator[str]:
    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, format, *args):
            pass

    handler = functools.partial(Quiet, directory=str(folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_address[1]}/"
        server.shutdown()


@pytest.fixture(scope="module")
def browser():
    with chromium() as started:
        yield started


@pytest.fixture
def visit(browser, site):
    """Return a function that opens the page, with every other site blocked."""
    contexts, complaints = [], []

    def open_page(query: str = "", width: int = 900, height: int = 560, before: str = ""):
        context = browser.new_context(viewport={"width": width, "height": height}, **COARSE)
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(1000 * PATIENCE)
        page.route(lambda address: not address.startswith(site), lambda route: route.abort())
        page.on("console", lambda m: m.type == "error" and complaints.append(m.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.add_init_script(f"{FEW_FRAMES}; {before}")
        page.goto(site + query)
        return page

    open_page.complaints = complaints
    yield open_page
    for context in contexts:
        context.close()


@pytest.fixture
def empty(browser, site):
    """A page of the site that runs nothing by itself."""
    page = browser.new_page()
    page.set_default_timeout(1000 * PATIENCE)
    page.goto(f"{site}libraries/three.LICENSE.txt")
    yield page
    page.close()


def runs(page) -> None:
    """Wait until the robot moves."""
    page.wait_for_function("parseFloat(document.getElementById('clock').textContent) > 0.1")


@pytest.mark.parametrize("number", [0, 1])
def test_physics_follows_c_mujoco(empty, site, folder, number):
    packed = (folder / f"runs/{number}/run.json.packed").read_bytes()
    about = json.loads(gzip.decompress(packed))
    run = ["cheetah3", str(folder.parent / "run")][number]
    env, _ = build(morlax_torch.load(run))
    exact = envs.make_robot(morlax_torch.load(run).config.env, **env.options.model_dump()).physics
    random = np.random.default_rng(0)
    controls = random.uniform(-0.5, 0.5, (STEPS, exact.model.nu))
    expected = []
    for control in controls:
        exact.ctrl[0] = torch.from_numpy(control)
        exact.step()
        expected.append(exact.qpos[0].numpy().copy())
    found = empty.evaluate(SIMULATE, [site, f"runs/{number}", controls.tolist()])
    assert about["dt"] == env.dt and about["terms"] == list(env.terms())
    gap = np.abs(np.array(found) - expected).max()
    assert gap < 1e-6, gap


@pytest.mark.parametrize("number", [0, 1])
def test_observations_and_actions_are_those_of_python(empty, site, folder, number):
    run = ["cheetah3", str(folder.parent / "run")][number]
    policy = morlax_torch.load(run)
    env, _ = build(policy)
    tradeoff = [0.5, *[0.5 / (len(policy.objectives) - 1)] * (len(policy.objectives) - 1)]
    steps = empty.evaluate(ACT, [site, f"runs/{number}", tradeoff, STEPS])
    assert len(steps) == STEPS
    observation = env.reset()
    for step in steps:
        action = policy(observation, tradeoff)
        torch.testing.assert_close(torch.tensor([step["action"]]), action, atol=1e-4, rtol=0)
        for name, field in (("qpos", "qpos"), ("qvel", "qvel"), ("sensors", "sensordata")):
            getattr(env.physics, name)[0] = torch.tensor(step[field])
        observation = torch.tensor([step["observation"]])
        torch.testing.assert_close(observation, env.observe(), atol=1e-4, rtol=1e-5)


def test_a_recorded_robot_moves_before_the_physics_has_come(visit):
    page = visit("?run=cheetah3", before=HELD)
    page.wait_for_selector("#loading.over")
    pictures = {page.locator("#view").screenshot()}
    while len(pictures) < 3:
        page.wait_for_timeout(100)
        pictures.add(page.locator("#view").screenshot())
    assert page.inner_text("#progress").startswith("Recorded; loading cheetah3: ")
    assert page.is_hidden("#panel") and page.is_hidden("#controls")
    page.wait_for_function("typeof go === 'function'")
    page.evaluate("go()")
    runs(page)
    assert page.is_visible("#panel") and page.is_hidden("#loading")
    come, due = re.findall(r"[\d.]+(?= of|  ?MB)", page.text_content("#progress"))
    assert come == due and not visit.complaints
    first, *later = page.evaluate(SHOW_AGAIN)
    assert later == [first] * 2  # on the graphics card


def test_a_link_opens_a_trade_off_and_a_slider_changes_it(visit):
    page = visit("?run=cheetah3&tradeoff=0.7,0.3,0")
    runs(page)
    assert page.title() == "cheetah3 · morlax"
    shares = page.locator("#weights output")
    assert shares.all_inner_texts() == ["70 %", "30 %", "0 %"]
    page.locator("#weights input").last.press("End")
    expect(shares).to_have_text(["0 %", "0 %", "100 %"])
    expect(page).to_have_url(re.compile("tradeoff=0,0,1$"))
    page.locator("#triangle svg").click(position={"x": 160, "y": 40})
    expect(shares.first).to_have_text(re.compile(r"^(8[1-9]|9\d|100) %$"))
    clicked = page.url
    page.locator("#triangle svg").press("ArrowDown")
    expect(page).not_to_have_url(clicked)
    assert not visit.complaints


def test_buttons_pause_push_and_reset_and_another_robot_can_be_chosen(visit):
    page = visit("?tradeoff=constructor&theme=none")
    runs(page)
    assert page.inner_text("#event") == "cheetah3 has no trade-off constructor: this is the balance"
    # without a graphics card the page draws fewer pixels
    stage, _ = boxes(page)
    drawn = page.evaluate("document.getElementById('view').width / devicePixelRatio")
    assert drawn == pytest.approx(stage["width"] / 2, abs=2 / 0.3)
    page.click("#pause")
    expect(page.locator("#timeline")).to_be_visible()
    stopped = page.inner_text("#clock")
    page.wait_for_timeout(500)
    assert page.inner_text("#clock") == stopped
    for name in ("push", "camera", "pace", "theme", "reset"):
        page.click(f"#{name}")
    page.wait_for_function("document.getElementById('clock').textContent === '0.0 s'")
    expect(page.locator("#pace")).to_contain_text("0.5")
    page.click("#pause")
    runs(page)
    page.select_option("#run", label="Tumbler")
    page.wait_for_function("document.title.startsWith('Tumbler')")
    runs(page)
    expect(page.locator("#weights .name")).to_have_text(["go", "save"])
    assert not visit.complaints


def test_robots_are_compared_and_chosen_without_a_server(visit):
    page = visit("?run=cheetah3&tradeoff=1,0,0")
    runs(page)

    def press(name: str) -> None:
        page.get_by_role("button", name=name, exact=True).click()

    names = page.locator("#names span")
    press("add a robot")
    press("energy saved")
    expect(names).to_have_text(["1: run 100 %", "2: energy saved 100 %"])
    expect(page.locator("#front .mark")).to_have_count(2)
    runs(page)
    press("remove")
    expect(names).to_have_count(0)
    runs(page)
    page.click("#choosing-section summary")
    least = page.locator("#levels input").first
    least.press("End")
    page.wait_for_selector("#found[data-state=found]")
    assert page.inner_text("#found").startswith("Best evaluated policy: run per second ")
    assert page.locator("#front .out").count() > 10
    page.locator("#levels input").nth(1).press("End")
    page.wait_for_selector("#found[data-state=missed]")
    press("thresholds off")
    expect(page.locator("#front .out")).to_have_count(0)
    assert page.get_by_role("button", name="A or B?").count() == 0 and page.is_hidden("#keep")
    press("add a robot")
    page.select_option("#run", label="Tumbler")
    expect(names).to_have_count(0)
    runs(page)
    assert page.is_hidden("#problem") and not visit.complaints


def test_a_second_visit_needs_no_network(visit):
    page = visit("?run=cheetah3")
    runs(page)
    # `wait_for_function` takes a promise for true
    until(page, lambda: page.evaluate(KEPT), "the page's files are not kept")
    page.context.set_offline(True)
    page.reload()
    runs(page)
    assert page.title() == "cheetah3 · morlax"


def test_an_embedded_page_shows_robot_sliders_and_front_only(visit):
    page = visit("?embed&run=cheetah3", 900, 500)
    runs(page)
    shown = [page.is_visible(f"#{part}") for part in ("view", "weights", "front")]
    hidden = [page.is_visible(part) for part in ("header", "#episode-section", "#controls")]
    assert all(shown) and not any(hidden)
    stage, panel = boxes(page)
    assert stage["height"] == panel["height"] == 500
    page = visit("?embed", 390, 640)  # an address that names no run
    runs(page)
    assert page.is_visible("#run") and page.is_hidden("#theme")


def boxes(page) -> list[dict[str, float]]:
    """Return where the robot and the panel are."""
    return [page.locator(part).bounding_box() for part in ("#stage", "#panel")]


def test_on_a_phone_the_panel_lies_below_the_robot_and_is_large_enough_to_tap(visit):
    page = visit("?run=cheetah3", 390, 844)
    runs(page)
    sizes = page.evaluate(TARGETS)
    assert len(sizes) > 10
    small = {k: v for k, v in sizes.items() if min(v) < 44}
    assert not small
    stage, panel = boxes(page)
    assert stage["width"] == panel["width"] == 390
    assert panel["y"] >= stage["y"] + stage["height"]
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    page.locator("#terms-section summary").scroll_into_view_if_needed()
    page.click("#terms-section summary")
    expect(page.locator("#terms")).to_be_visible()

    # a laptop at a zoom of 200 %: every button is on the stage, and sliders can be dragged
    page.set_viewport_size({"width": 683, "height": 384})
    stage, _ = boxes(page)
    buttons = [button.bounding_box() for button in page.locator("#controls button:visible").all()]
    assert buttons[0]["x"] >= 0 and buttons[-1]["x"] + buttons[-1]["width"] <= stage["width"]
    assert page.locator("#weights input").first.bounding_box()["width"] >= 80


@pytest.mark.parametrize(
    ("before", "sentence"),
    [
        ("HTMLCanvasElement.prototype.getContext = () => null", "cannot draw in 3D"),
        ("const get = fetch; globalThis.fetch = () => get('nowhere')", "is missing on this web"),
    ],
)
def test_what_a_browser_lacks_is_one_sentence(visit, before, sentence):
    page = visit("", before=before)
    page.wait_for_selector("#problem:not([hidden])")
    assert sentence in page.inner_text("#problem")
    assert page.is_hidden("#loading")
