// The page: load the robots, run the chosen one in real time, and react to the visitor.

import { Problem, fetched, traffic } from "./files.js";
import { Panel } from "./panel.js";
import { html, icon } from "./pictures.js";
import { even, parsed, shown } from "./weights.js";

const MOST_DELAY = 0.1; // s to catch up with; the rest of a longer delay is dropped
const PACES = [1, 0.5, 0.25];
const OVER = { fell: "The episode ended: new start", time: "Time is up: new start" };
const $ = (id) => document.getElementById(id);
const query = new URLSearchParams(location.search);
const state = {
  simulation: null,
  folder: "",
  panel: null,
  stage: null,
  paused: false,
  pace: 1,
  resets: false,
  from: 0, // index of the past pose that a replay started from
  played: 0, // control steps since then
};
const former = []; // simulations to release between two steps
let asks = 0; // how often a run was asked for

async function main() {
  if (typeof WebAssembly !== "object") {
    throw new Problem("This browser lacks WebAssembly: use a current Firefox, Chrome, Edge or Safari.");
  }
  document.body.classList.toggle("embed", query.has("embed"));
  const { Stage } = await import("./stage.js");
  state.stage = new Stage($("view"));
  followTheme();
  const runs = await (await fetched("runs.json")).json();
  // An embedded page has a chooser only if its address leaves the choice open.
  document.body.classList.toggle("one", runs.length < 2 || query.has("run"));
  listRuns(runs);
  wireControls();
  await open(asked(runs));
  $("controls").hidden = $("panel").hidden = false;
  keepFiles().catch(() => {}); // browsers may forbid it, and the page works without
  run().catch(report);
}

/** Return the run that the address asks for by title or number. */
function asked(runs) {
  const name = query.get("run");
  const found = runs.find((run, i) => run.title === name || String(i) === name);
  if (found || name === null) return found ?? runs[0];
  throw new Problem(`There is no robot ${name} here, but ${runs.map((run) => run.title).join(", ")}.`);
}

/** Show one of the runs, unless the visitor chooses another one before it is loaded. */
async function open(run) {
  const ask = ++asks;
  const simulation = await load(run).catch((error) => {
    if (ask < asks) return null;
    if (!state.simulation) throw error;
    $("run").value = state.folder; // the robot on the stage goes on
    $("loading").hidden = true;
    announce(sentence(error));
    return null;
  });
  if (!simulation || ask < asks) {
    if (simulation) former.push(simulation);
    return;
  }
  if (state.simulation) former.push(state.simulation);
  state.folder = run.folder;
  const m = simulation.about.objectives.length;
  simulation.tradeoff = parsed(query.get("tradeoff"), m) ?? even(m);
  document.title = `${run.title} · morlax`;
  $("title").textContent = run.title;
  $("run").value = run.folder;
  $("push").disabled = simulation.about.pushed.length === 0;
  state.stage.show(simulation);
  state.panel = new Panel(simulation, choose, remember);
  state.panel.showEpisode();
  state.simulation = simulation;
  $("loading").hidden = true;
}

async function load({ title, folder, bytes, shared }) {
  const size = bytes + (state.simulation ? 0 : shared);
  const begin = traffic.come;
  traffic.follow = () => {
    const [come, due] = [traffic.come - begin, size].map((x) => (x / 1e6).toFixed(1));
    $("progress").textContent = `Loading ${title}: ${come} of ${due} MB`;
  };
  traffic.follow();
  $("loading").classList.toggle("over", Boolean(state.simulation));
  $("loading").hidden = false;
  const { Simulation } = await import("./simulation.js");
  return Simulation.load(folder);
}

/** Keep all files that this visit needed, for visits without a network. */
async function keepFiles() {
  await navigator.serviceWorker.register("sw.js");
  const used = performance.getEntriesByType("resource").map(({ name }) => name);
  const ours = used.filter((address) => address.startsWith(location.origin));
  await (await caches.open("morlax")).addAll([...new Set(["./", ...ours])]);
}

function choose(tradeoff) {
  if (!state.simulation) return;
  state.simulation.tradeoff = tradeoff;
  state.panel.showTradeoff();
}

/** Put robot and trade-off into the address, so that it can be shared. */
function remember() {
  if (!state.simulation) return;
  query.set("run", $("title").textContent);
  query.set("tradeoff", shown(state.simulation.tradeoff));
  history.replaceState(null, "", `?${query.toString().replaceAll("%2C", ",").replace("embed=", "embed")}`);
}

/** Step and draw until an error ends it. */
async function run() {
  let last = performance.now();
  let due = 0;
  const frame = () => new Promise(requestAnimationFrame);
  for (;;) {
    await frame();
    for (const simulation of former.splice(0)) await simulation.release();
    const now = performance.now();
    const elapsed = Math.min((now - last) / 1000, MOST_DELAY);
    last = now;
    const { simulation, stage, panel, paused, pace } = state;
    if (!simulation) continue;
    if (!paused && stage.moment !== null) replay(stage, (elapsed * pace) / simulation.about.dt);
    else if (!paused) due += elapsed * pace;
    if (state.resets) restart(simulation);
    while (due >= simulation.about.dt && performance.now() - now < 1000 * MOST_DELAY) {
      due -= simulation.about.dt;
      if (simulation.over) restart(simulation);
      await simulation.step();
      stage.advance();
      if (simulation.over) announce(OVER[simulation.over]);
    }
    due = Math.min(due, simulation.about.dt);
    if (simulation !== state.simulation) continue;
    stage.draw(Math.min(due / simulation.about.dt, 1));
    panel.showEpisode();
    showClock(simulation);
  }
}

function restart(simulation) {
  state.resets = false;
  simulation.reset();
  state.stage.jump();
}

/** Draw later poses of the past, until the present is reached. */
function replay(stage, steps) {
  state.played += steps;
  stage.moment = Math.min(state.from + Math.floor(state.played), stage.past.length - 1);
  if (stage.moment === stage.past.length - 1) stage.moment = null;
}

/** Show the time of the pose on the stage. */
function showClock({ steps, about }) {
  const { past, moment } = state.stage;
  const shown = moment === null ? steps : past[moment].steps;
  $("clock").textContent = `${(shown * about.dt).toFixed(1)} s`;
}

function announce(text) {
  const place = $("event");
  place.textContent = text;
  place.classList.remove("fading");
  void place.offsetWidth; // restarts the animation
  place.classList.add("fading");
}

function listRuns(runs) {
  const list = $("run");
  list.replaceChildren(...runs.map((run) => new Option(run.title, run.folder)));
  list.hidden = runs.length < 2;
  $("title").hidden = runs.length > 1;
  list.addEventListener("change", () => {
    query.delete("tradeoff");
    const run = runs.find(({ folder }) => folder === list.value);
    open(run).then(remember, report);
  });
}

function wireControls() {
  const actions = {
    pause: () => {
      state.paused = !state.paused;
      $("timeline").hidden = !state.paused;
      $("timeline").max = $("timeline").value = state.stage.past.length - 1;
      $("pause").replaceChildren(icon(state.paused ? "play" : "pause"));
      $("pause").title = state.paused ? "Continue (space)" : "Pause (space)";
    },
    push: () => state.simulation?.push(),
    reset: () => (state.resets = true),
    camera: () => state.stage.lookHome(),
    photo: () => save().catch((error) => announce(sentence(error))),
    pace: () => {
      state.pace = PACES[(PACES.indexOf(state.pace) + 1) % PACES.length];
      $("pace").textContent = `${state.pace}×`;
    },
  };
  for (const [name, act] of Object.entries(actions)) {
    $(name).addEventListener("click", act);
    if (name !== "pace") {
      $(name).replaceChildren(icon(name));
      $(name).setAttribute("aria-label", $(name).title);
    }
  }
  $("timeline").addEventListener("input", () => {
    state.from = Math.min(Number($("timeline").value), state.stage.past.length - 1);
    state.stage.moment = state.from;
    state.played = 0;
  });
  const keys = { " ": "pause", p: "push", r: "reset", c: "camera" };
  addEventListener("keydown", (event) => {
    const typing = event.target.closest("button, select, input, summary");
    const name = keys[event.key.toLowerCase()];
    if (!name || typing || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    actions[name]();
  });
}

/** Save what the stage shows as a PNG file. */
async function save() {
  const address = URL.createObjectURL(await state.stage.picture());
  const name = `${$("title").textContent} ${shown(state.simulation.tradeoff)}.png`;
  html("a", { href: address, download: name }).click();
  URL.revokeObjectURL(address);
}

/** Follow the system's light or dark theme, until the visitor switches. */
function followTheme() {
  const system = matchMedia("(prefers-color-scheme: dark)");
  let chosen = query.get("theme");
  const dress = () => {
    const theme = chosen ?? (system.matches ? "dark" : "light");
    document.documentElement.dataset.theme = theme;
    state.stage.dress(theme);
    $("theme").replaceChildren(icon(theme === "dark" ? "sun" : "moon"));
  };
  system.addEventListener("change", dress);
  $("theme").setAttribute("aria-label", $("theme").title);
  $("theme").addEventListener("click", () => {
    chosen = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
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
