// The page: show the robots of an engine in real time, and react to the visitor.

import { Recorded } from "./engines/recorded.js";
import { Problem, fetched, traffic } from "./files.js";
import { drive, press } from "./panel/driving.js";
import { Panel } from "./panel/panel.js";
import { $, html, isNews, onArrows, setIcon } from "./pictures.js";
import * as talk from "./panel/talk.js";
import { even, parsed, shown } from "./tradeoffs.js";

const PACES = [1, 0.5, 0.25];
const TURN = 0.1; // radians of the camera per key
const query = new URLSearchParams(location.search);
const remote = document.documentElement.dataset.engine === "remote";
const state = {
  engine: null,
  folder: "", // of the run, without a server
  panel: null,
  stage: null,
  replays: false,
  clock: 0, // control steps of the stage, at which a replay is
};
let asks = 0; // how often a run was asked for

async function main() {
  if (!remote && typeof WebAssembly !== "object") {
    throw new Problem("This browser lacks WebAssembly: use a current Firefox, Chrome, Edge or Safari.");
  }
  document.body.classList.toggle("embed", query.has("embed"));
  const { Stage } = await import("./stage/stage.js");
  state.stage = new Stage($("view"), $("names"));
  followTheme();
  wireControls();
  await (remote ? connect() : openPacked());
  $("controls").hidden = $("panel").hidden = false;
  if (!remote) keepFiles().catch(() => {}); // browsers may forbid it, and the page works without
  run().catch(report);
}

/** Show what the server of `morlax explore` shows. */
async function connect() {
  const { Remote } = await import("./engines/remote.js");
  const lost = () => announce("The server has stopped, or the connection is lost", true);
  const step = () => state.engine && state.stage.advance();
  const engine = await Remote.connect({ step, tell: announce, lost, renew: () => present(state.engine) });
  present(engine);
}

/** Show one of the runs that `pack --web` wrote. */
async function openPacked() {
  const runs = await (await fetched("runs.json")).json();
  // An embedded page has a chooser only if its address leaves the choice open.
  document.body.classList.toggle("one", runs.length < 2 || query.has("run"));
  const list = $("run");
  list.replaceChildren(...runs.map((run) => new Option(run.title, run.folder)));
  list.hidden = runs.length < 2;
  list.addEventListener("change", () => {
    query.delete("tradeoff");
    const run = runs.find(({ folder }) => folder === list.value);
    open(run).then(remember, report);
  });
  await open(asked(runs));
}

/** Return the run that the address asks for by title or number. */
function asked(runs) {
  const name = query.get("run");
  const match = runs.find((run, i) => run.title === name || String(i) === name);
  if (match || name === null) return match ?? runs[0];
  throw new Problem(`There is no robot ${name} here, but ${runs.map((run) => run.title).join(", ")}.`);
}

/** Show one of the runs, unless the visitor chooses another one before it is loaded. */
async function open(run) {
  const ask = ++asks;
  let engine;
  try {
    engine = await load(run);
  } catch (error) {
    if (ask < asks) return;
    if (!state.engine) throw error;
    $("run").value = state.folder; // the robot on the stage goes on
    $("loading").hidden = true;
    announce(sentence(error));
    return;
  }
  if (ask < asks) return engine.release();
  state.folder = run.folder;
  engine.about.title = run.title;
  const m = engine.about.objectives.length;
  const wanted = query.get("tradeoff");
  const bookmark = wanted?.replace(/^@/, "");
  const named = Object.hasOwn(engine.bookmarks, bookmark) ? engine.bookmarks[bookmark] : parsed(wanted, m);
  engine.steer(named ?? even(m));
  $("run").value = run.folder;
  present(engine);
  if (wanted && !named) announce(`${run.title} has no trade-off ${wanted}: this is the balance`);
}

/** Show the recording of a run until a robot is loaded; returns whether there is one. */
async function preview(folder) {
  try {
    const recorded = await Recorded.load(folder);
    state.stage.show(recorded);
    const ended = () => state.engine || $("loading").hidden;
    recorded.play(state.stage, ended).catch(() => {}); // the robot itself follows
    return true;
  } catch {
    return false; // the page works without
  }
}

async function load({ title, folder, bytes, shared }) {
  const recorded = !state.engine && (await preview(folder));
  const size = bytes + (state.engine ? 0 : shared);
  const begin = traffic.come;
  traffic.follow = () => {
    Object.assign($("share"), { max: size, value: traffic.come - begin });
    const [come, due] = [traffic.come - begin, size].map((x) => (x / 1e6).toFixed(1));
    const what = recorded ? "Recorded; loading" : "Loading";
    $("progress").textContent = `${what} ${title}: ${come} of ${due} MB`;
  };
  traffic.follow();
  $("loading").classList.toggle("over", recorded || Boolean(state.engine));
  $("loading").hidden = false;
  const { Local } = await import("./engines/local.js");
  const engine = await Local.load(folder);
  engine.listener = { step: () => state.engine === engine && state.stage.advance(), tell: announce };
  return engine;
}

function present(engine) {
  const { title, pushed } = engine.about;
  document.title = `${title} · morlax`;
  $("title").textContent = title;
  $("push").disabled = pushed.length === 0;
  state.replays = false;
  state.engine = engine;
  state.stage.show(engine);
  state.panel = new Panel(engine, state.stage, remember);
  state.panel.show();
  $("loading").hidden = true;
}

/** Keep all files that this visit needed, for visits without a network; sw.js keeps those of later visits. */
async function keepFiles() {
  if (navigator.serviceWorker.controller) return;
  await navigator.serviceWorker.register("sw.js");
  const used = performance.getEntriesByType("resource").map(({ name }) => name);
  const ours = used.filter((address) => address.startsWith(location.origin));
  await (await caches.open("morlax")).addAll(new Set([location.pathname, ...ours]));
}

/** Put robot and trade-off into the address, so that it can be shared. */
function remember() {
  if (remote) return;
  query.set("run", state.engine.about.title);
  query.set("tradeoff", shown(state.engine.steered.tradeoff));
  history.replaceState(null, "", `?${query.toString().replaceAll("%2C", ",").replace("embed=", "embed")}`);
}

/** Step and draw until an error ends it. */
async function run() {
  let last = performance.now();
  let { engine } = state;
  const frame = () => new Promise(requestAnimationFrame);
  for (;;) {
    await frame();
    const former = engine;
    engine = state.engine;
    if (former !== engine) await former.release(); // between two frames
    const now = performance.now();
    const elapsed = (now - last) / 1000;
    last = now;
    const { stage } = state;
    if (state.replays) replay(stage, (elapsed * engine.pace) / engine.about.dt);
    if (!engine.paused) stopLookingBack(); // another tab may continue
    const share = await engine.advance(stage.moment === null ? elapsed : 0);
    if (engine !== state.engine) continue;
    if (engine.scene !== stage.source) stage.show(engine);
    stage.draw(share);
    state.panel.show();
    $("talk").hidden = !Object.keys(engine.bookmarks ?? {}).length;
    drive(engine);
    showPlayback(engine, stage);
  }
}

/** Draw later poses of the past, until the present is reached. */
function replay(stage, steps) {
  state.clock += steps;
  stage.moment = stage.past.findLastIndex(({ clock }) => clock <= state.clock);
  if (stage.moment === stage.past.length - 1) state.engine.pause(false);
}

function stopLookingBack() {
  state.stage.moment = null;
  state.replays = false;
}

/** Show the time of the pose on the stage, and what the buttons do now. */
function showPlayback(engine, stage) {
  const { past, moment } = stage;
  const { steps } = past.at(moment ?? -1)[engine.selected] ?? past.at(-1)[0];
  const { dt, motion } = engine.about;
  $("clock").textContent = `${(steps * dt).toFixed(1)} ${motion ? `of ${motion.toFixed(1)} ` : ""}s`;
  $("clock").classList.toggle("phase", Boolean(motion));
  $("clock").style.setProperty("--share", (steps * dt) / motion);
  const { paused, pace, failure } = engine;
  if (isNews($("event"), failure)) {
    if (failure) announce(failure, true);
    else $("event").classList.remove("staying");
  }
  const stopped = paused && !state.replays;
  $("timeline").hidden = !stopped;
  $("timeline").max = past.length - 1;
  $("timeline").ariaValueText = $("clock").textContent;
  if (moment === null) $("timeline").value = past.length - 1;
  if (!isNews(state, stopped, pace)) return;
  if (stopped) label("pause", "Continue (space)", "play", "continue");
  else label("pause", "Pause (space)", "pause", "pause");
  $("pace").lastElementChild.textContent = `${pace}×`;
}

/** Show a sentence above the robots, for as long as it takes to read, or until the next one. */
function announce(text, stays = false) {
  const line = $("event");
  line.textContent = text;
  line.classList.toggle("staying", stays);
  for (const former of line.getAnimations()) former.cancel();
  if (!stays) line.animate({ opacity: [1, 1, 0], offset: [0, 0.7, 1] }, Math.max(2400, 70 * text.length));
}

function wireControls() {
  const actions = {
    pause: () => {
      const { engine, stage } = state;
      if (!engine.paused) engine.pause(true);
      else if (stage.moment === null) engine.pause(false);
      else state.replays = !state.replays;
    },
    reset: stopLookingBack,
    camera: () => state.stage.lookHome(),
    photo: async () => download(await state.stage.picture()),
    clip: film,
    talk: () => talk.begin(state.engine),
    pace: () => state.engine.setPace(PACES[(PACES.indexOf(state.engine.pace) + 1) % PACES.length]),
    "keys-button": () => $("help").showModal(),
  };
  for (const [button, act] of Object.entries(actions)) {
    $(button).addEventListener("click", async () => {
      try {
        await act();
      } catch (error) {
        announce(sentence(error));
      }
    });
  }
  $("timeline").addEventListener("input", () => {
    const { stage } = state;
    stage.moment = Math.min($("timeline").valueAsNumber, stage.past.length - 1);
    state.clock = stage.past[stage.moment].clock;
  });
  onArrows($("view"), (right, up) => {
    state.stage.controls.rotateLeft(right * TURN);
    state.stage.controls.rotateUp(up * TURN);
  });
  // Space presses a button that has the focus, and letters choose from a list, but a click is not to keep it
  addEventListener("click", ({ detail, target }) => {
    const button = target.closest("button, summary");
    if (button?.dataset.press) state.engine.press(button.dataset.press);
    if (detail) button?.blur();
  });
  const clicked = ":is(select, [type=checkbox]):not(:focus-visible)";
  addEventListener("change", ({ target }) => target.matches(clicked) && target.blur());
  addEventListener("keydown", (event) => {
    if (!state.engine || $("help").open || event.ctrlKey || event.metaKey || event.altKey || isOwn(event)) return;
    const key = CSS.escape(event.key.toLowerCase());
    const button = document.querySelector(`[data-key="${key}"]:not([aria-pressed="true"])`);
    button?.click();
    if (button || talk.follow(state.engine, event.key) || press(state.engine, event.key)) event.preventDefault();
  });
}

/** Return whether the element that has the focus needs a key itself. */
function isOwn({ target, key, defaultPrevented }) {
  if (defaultPrevented || target.matches("select, input:not([type=range], [type=checkbox])")) return true;
  if (target.matches("[type=range]")) return /^(Arrow|Page|Home|End)/.test(key);
  return /^( |Enter)$/.test(key) && target.matches("button, summary, input");
}

/** Begin a clip, or end it and save it as a video. */
async function film() {
  const { capture } = state.stage;
  const ends = capture.recorder !== null;
  label("clip", ends ? "Record a clip" : "End the clip and save it", ends ? "clip" : "stop", "clip");
  $("clip").setAttribute("aria-pressed", !ends);
  if (ends) download(await capture.end());
  else capture.record();
}

function download(data) {
  const [, ending] = data.type.split(/[/;]/); // of image/png, video/mp4 or video/webm
  const address = URL.createObjectURL(data);
  const { about, steered } = state.engine;
  html("a", { href: address, download: `${about.title} ${shown(steered.tradeoff)}.${ending}` }).click();
  URL.revokeObjectURL(address);
}

function label(id, title, icon, word) {
  $(id).title = title;
  $(id).lastElementChild.textContent = word;
  setIcon($(id), icon);
}

/** Follow the system's light or dark theme, until the visitor switches. */
function followTheme() {
  const system = matchMedia("(prefers-color-scheme: dark)");
  let chosen = ["light", "dark"].find((theme) => theme === query.get("theme"));
  const dress = () => {
    const theme = chosen ?? (system.matches ? "dark" : "light");
    document.documentElement.style.colorScheme = theme;
    state.stage.dress(theme);
    setIcon($("theme"), theme === "dark" ? "sun" : "moon");
  };
  system.addEventListener("change", dress);
  $("theme").addEventListener("click", () => {
    chosen = document.documentElement.style.colorScheme === "dark" ? "light" : "dark";
    dress();
  });
  dress();
}

function sentence(error) {
  if (error instanceof Problem) return error.message;
  return `The page cannot run here: ${error.message ?? error}.`;
}

/** Show one sentence in place of the robot. */
function report(error) {
  $("loading").hidden = $("controls").hidden = true;
  $("problem").hidden = false;
  $("problem").textContent = sentence(error);
}

main().catch(report);
