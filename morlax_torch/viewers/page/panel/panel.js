// The panel beside the robots: everything of one run.

import { AskingPanel } from "./asking.js";
import { Charts } from "./charts.js";
import { ChoosingPanel } from "./choosing.js";
import { Episode } from "./episode.js";
import { FrontPlot } from "./front.js";
import { LineupPanel, showNames } from "./lineup.js";
import { $, html, isNews, percent } from "../pictures.js";
import { colorOf, keeping, mixed, moved, robotColor } from "../tradeoffs.js";
import { RunLists, SavingPanel } from "./runs.js";
import { Sliders } from "./sliders.js";
import { Triangle } from "./triangle.js";
import { TypedWeights } from "./typing.js";

const KINDS = { velocity: "velocity", command: "command", contacts: "contact forces", trail: "trail" };

export class Panel {
  /** `settled` is called when a visitor has chosen a trade-off, and lets go of a slider or plot. */
  constructor(engine, stage, settled) {
    Object.assign(this, { engine, stage });
    const { about } = engine;
    this.names = about.objectives;
    this.front = about.front ?? null;
    this.parts = [new AskingPanel(engine)];
    if (engine.can.open) this.parts.push(new RunLists(engine));
    this.plots = [];
    $("choosing-section").hidden = !this.front;
    const [rounded, precise] = [(x) => x.toFixed(2), (x) => x.toPrecision(3)];
    const [tell, reshape] = ["tell", "reshape"].map((act) => (index, value) => engine[act](index, value));
    const measure = () => engine.press("measure");
    this.command = this.#showNumbers("command", about.command?.limits, rounded, tell);
    this.design = this.#showNumbers("design", about.design, precise, reshape, measure);
    this.#showKinds(about);
    const choose = (weights) => {
      if (!engine.asking) engine.steer(weights);
    };
    this.#showWeights(choose, settled);
    this.#showPlots(choose);
    $("triangle").onpointerup = $("front").onpointerup = settled;
    this.parts.push(
      new TypedWeights(engine, (weights) => (choose(weights), settled())),
      new LineupPanel(engine),
      new Episode(engine),
      new Charts(engine),
      new SavingPanel(engine),
    );
    if (this.front) this.parts.push(new ChoosingPanel(engine, settled));
  }

  /** Show the present. */
  show() {
    const { engine } = this;
    for (const part of this.parts) part.show();
    showNames(engine);
    const { steered, robots, selected, asking, choosing } = engine;
    this.weights.show(steered.tradeoff);
    this.command?.show(engine.command);
    this.design?.show(engine.state.design);
    $("front-section").classList.toggle("stale", this.design !== undefined && !engine.state.measured);
    const tradeoffs = robots.map(({ tradeoff }) => tradeoff);
    if (!this.front || !isNews(this, tradeoffs, selected, asking, choosing?.levels)) return;
    const others = robots.map((_, i) => i).filter((i) => i !== selected || asking);
    const marks = (asking ? others : [...others, selected]).map((i) => {
      const outline = robots.length > 1 ? robotColor(i) : "#fff";
      return { weights: robots[i].tradeoff, fill: mixed(robots[i].tradeoff), outline };
    });
    for (const plot of this.plots) plot.show(marks);
    this.map?.limit(this.#standing());
  }

  /** Return the indices of points that are still of interest; null: all. */
  #standing() {
    const { asking, choosing } = this.engine;
    if (asking) return asking.possible;
    const levels = choosing?.levels ?? {};
    return Object.keys(levels).length ? keeping(this.engine.about, levels) : null;
  }

  #showWeights(choose, settled) {
    const { engine } = this;
    const rows = this.names.map((name, i) => {
      const title = engine.about.notes?.[i];
      return { name, limits: [0, 1], color: colorOf(i), format: percent, title };
    });
    const move = (index, value) => choose(moved(engine.steered.tradeoff, index, value));
    this.weights = new Sliders(rows, move, settled);
    $("weights").replaceChildren(...this.weights.elements);
  }

  /** Show sliders for numbers with ranges in their section, or hide it; returns them. */
  #showNumbers(id, ranges, format, move, done) {
    $(`${id}-section`).hidden = !ranges;
    if (!ranges) return undefined;
    const look = { color: "var(--ink)", format };
    const rows = Object.entries(ranges).map(([name, limits]) => ({ name, limits, ...look }));
    const sliders = new Sliders(rows, move, done);
    $(id).replaceChildren(...sliders.elements);
    return sliders;
  }

  #showKinds(about) {
    const { stage, engine } = this;
    const offered = Object.keys(KINDS).filter((kind) => {
      if (kind === "command") return about.velocities;
      return kind !== "contacts" || engine.can.contacts;
    });
    const boxes = offered.map((kind) => {
      const box = html("input", { type: "checkbox", checked: stage.shown.has(kind) });
      box.addEventListener("change", () => stage.shown[box.checked ? "add" : "delete"](kind));
      return html("label", { className: "check" }, box, KINDS[kind]);
    });
    $("show").replaceChildren(...boxes);
  }

  #showPlots(choose) {
    const m = this.names.length;
    const triangle = m === 3 ? [new Triangle(this.names, choose)] : [];
    $("triangle").replaceChildren(...triangle.map((plot) => plot.element));
    this.triangle = this.plots = triangle;
    $("axes").hidden = !this.front || this.front.axes.length < 3;
    $("front").replaceChildren();
    $("checkpoint").textContent = this.front
      ? `front of ${this.front.checkpoint}`
      : "This checkpoint has no front. To write one: morlax evaluate RUN";
    if (!this.front) return;
    const draw = (axes) => {
      this.map = new FrontPlot(this.front, this.names, axes, choose);
      $("front").replaceChildren(this.map.element);
      this.plots = [...this.triangle, this.map];
      this.facts = null;
    };
    if (this.front.axes.length > 2) $("axes").replaceChildren(...axisChoosers(this.front, draw));
    draw(this.front.pair);
  }
}

/** Return two lists, for the axes of the plot. */
function axisChoosers(front, draw) {
  const lists = [0, 1].map((first) => {
    const options = front.axes.map((name, i) => {
      return new Option(name.replace(" per second", ""), i, false, i === front.pair[first]);
    });
    return html("select", { ariaLabel: first ? "Vertical axis" : "Horizontal axis" }, ...options);
  });
  const [across, up] = lists;
  const chosen = () => lists.map((list) => Number(list.value));
  let former = chosen();
  for (const list of lists) {
    list.addEventListener("change", () => {
      if (across.value === up.value) [across.value, up.value] = former.toReversed();
      former = chosen();
      draw(former);
    });
  }
  return [across, html("span", { textContent: "and" }), up];
}
