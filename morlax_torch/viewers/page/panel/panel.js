// The panel beside the robots: everything of one run.

import { colorOf, mixed, robotColor } from "../colors.js";
import { AskingPanel } from "./asking.js";
import { Charts } from "./charts.js";
import { ChoosingPanel } from "./choosing.js";
import { Episode } from "./episode.js";
import { FrontPlot } from "./front.js";
import { LineupPanel, RobotNames } from "./lineup.js";
import { html, percent } from "../pictures.js";
import { keeping } from "../requirements.js";
import { RunLists } from "./runs.js";
import { SavingPanel } from "./saving.js";
import { Sliders } from "./sliders.js";
import { Triangle } from "./triangle.js";
import { TypedWeights } from "./typing.js";
import { moved } from "./weights.js";

const $ = (id) => document.getElementById(id);
const KINDS = { velocity: "velocity", command: "command", contacts: "contact forces", trail: "trail" };

export class Panel {
  /**
   * @param engine that moves the robots.
   * @param stage that shows them.
   * @param settled called when a visitor has chosen a trade-off, and lets go of a slider or plot.
   */
  constructor(engine, stage, settled) {
    Object.assign(this, { engine, stage });
    const { about } = engine;
    this.names = about.objectives;
    this.front = about.front ?? null;
    this.parts = [new AskingPanel(engine), new RobotNames(engine)];
    if (engine.can.open) this.parts.push(new RunLists(engine));
    this.plots = [];
    const sections = ["robots", "tradeoff", "front", "episode"].map((name) => $(`${name}-section`));
    for (const section of sections) section.hidden = this.names.length === 0;
    $("choosing-section").hidden = !this.front || this.names.length === 0;
    this.#showCommand(about.command);
    this.#showDesign(about.design);
    this.#showKinds(about);
    if (!this.names.length) return;
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
    if (!this.names.length) return;
    const { steered, robots, selected, asking, choosing } = engine;
    this.weights.show(steered.tradeoff);
    this.command?.show(engine.command);
    this.design?.show(engine.state.design);
    $("front-section").classList.toggle("stale", this.design !== undefined && !engine.state.measured);
    const key = JSON.stringify([robots.map((r) => r.tradeoff), selected, asking, choosing?.levels]);
    if (key === this.shown || !this.front) return;
    this.shown = key;
    const others = robots.map((_, i) => i).filter((i) => i !== selected || asking);
    const mark = (i, weights) => {
      const outline = robots.length > 1 ? robotColor(i) : "#fff";
      return { weights, fill: mixed(weights), outline };
    };
    const marks = others.map((i) => mark(i, robots[i].tradeoff));
    if (!asking) marks.push(mark(selected, steered.tradeoff));
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

  #showCommand(command) {
    $("command-section").hidden = !command;
    if (!command) return;
    const rows = Object.entries(command.limits).map(([unit, limits]) => {
      return { name: unit, limits, color: "var(--ink)", format: (value) => value.toFixed(2) };
    });
    this.command = new Sliders(rows, (index, value) => this.engine.tell(index, value));
    $("command").replaceChildren(...this.command.elements);
  }

  #showDesign(parameters) {
    $("design-section").hidden = !parameters;
    if (!parameters) return;
    const { engine } = this;
    const rows = Object.entries(parameters).map(([name, limits]) => {
      return { name, limits, color: "var(--ink)", format: (value) => value.toPrecision(3) };
    });
    const move = (index, value) => engine.reshape(index, value);
    this.design = new Sliders(rows, move, () => engine.press("measure"));
    $("design").replaceChildren(...this.design.elements);
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
      this.shown = null;
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
    const list = html("select", {}, ...options);
    list.setAttribute("aria-label", first ? "Vertical axis" : "Horizontal axis");
    return list;
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
