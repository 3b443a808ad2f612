// The panel beside the robots: everything of one run.

import { AskingPanel } from "./asking.js";
import { Charts } from "./charts.js";
import { ChoosingPanel } from "./choosing.js";
import { Episode } from "./episode.js";
import { FrontPlot } from "./front.js";
import { LineupPanel } from "./lineup.js";
import { Live } from "./live.js";
import { Matrix } from "./matrix.js";
import { $, isNews, percent } from "../pictures.js";
import { colorOf, mixed, moved, robotColor } from "../tradeoffs.js";
import { RunLists, showSaving } from "./runs.js";
import { Sliders } from "./sliders.js";
import { TrainingPanel } from "./training.js";
import { Triangle } from "./triangle.js";
import { TypedWeights } from "./typing.js";
import { keeping, present, setUnit, valuesOf } from "../values.js";

const HELD = "#panel :active, :is(#levels, #matrix) :focus"; // what a visitor holds is not replaced

export class Panel {
  /** `settled` is called when a visitor has chosen a trade-off, and lets go of a slider or plot. */
  constructor(engine, stage, settled) {
    Object.assign(this, { engine, stage });
    const { about } = engine;
    this.names = about.titles;
    const live = new Live(engine);
    this.parts = [new AskingPanel(engine), live];
    this.lists = [...$("axes").querySelectorAll("select")];
    $("axes").onchange = () => {
      const axes = this.lists.map(({ value }) => Number(value));
      this.#enlarge(axes[0] === axes[1] ? this.axes.toReversed() : axes); // the axes never have the same
    };
    if (engine.served) this.parts.push(new RunLists(engine));
    const [rounded, precise] = [(x) => x.toFixed(2), (x) => x.toPrecision(3)];
    const [tell, reshape] = ["tell", "reshape"].map((act) => (index, value) => engine[act](index, value));
    const measure = () => engine.press("measure");
    this.command = this.#showNumbers("command", about.command?.limits, rounded, tell);
    this.design = this.#showNumbers("design", about.design, precise, reshape, measure);
    this.#showKinds(about);
    this.choose = (weights) => {
      if (!engine.asking) engine.steer(weights);
      document.body.classList.add("knows"); // what the hint says
    };
    this.#showWeights(settled);
    this.triangle = this.names.length === 3 ? new Triangle(this.names, this.choose) : null;
    $("triangle").hidden = this.names.length !== 3;
    this.required = (index) => (this.#reveal(index), settled());
    this.training = new TrainingPanel(engine);
    this.#renew();
    for (const plot of [$("triangle"), $("front")]) plot.onpointerup = plot.onkeyup = settled;
    this.parts.push(
      new TypedWeights(engine, (weights) => (this.choose(weights), settled())),
      new LineupPanel(engine),
      new Episode(engine, live),
      new Charts(engine, stage, live),
    );
    for (const unit of ["second", "episode"]) $(`per-${unit}`).onclick = () => this.measureBy(unit);
  }

  /** Show the front, which training renews. */
  #renew() {
    const { engine } = this;
    const { front } = engine.about;
    Object.assign(this, { front, moments: engine.training });
    $("choosing-section").hidden = $("unit").hidden = !front;
    this.choosing = front ? new ChoosingPanel(engine, this.required) : null;
    this.#showPlots();
    this.measureBy(present());
  }

  /** Show all that is earned per second, or per episode. */
  measureBy(unit) {
    setUnit(unit);
    for (const each of ["second", "episode"]) $(`per-${each}`).setAttribute("aria-pressed", each === unit);
    if (this.front) this.#enlarge(this.axes);
  }

  show() {
    const { engine } = this;
    const isNew = engine.about.front !== this.front || engine.training !== this.moments;
    if (isNew && !document.querySelector(HELD)) this.#renew();
    for (const part of this.parts) part.show();
    this.choosing?.show();
    this.training.show();
    showSaving(engine);
    const { steered, robots, selected, asking, choosing, bookmarks } = engine;
    this.weights.show(steered.tradeoff);
    $("follow").hidden = typeof steered.follows !== "boolean";
    $("follow").setAttribute("aria-pressed", steered.follows);
    this.command?.show(engine.command);
    this.design?.show(engine.state.design);
    $("front-section").classList.toggle("stale", this.design !== undefined && !engine.state.measured);
    if (!this.plots.length) return;
    const tradeoffs = robots.map(({ tradeoff }) => tradeoff);
    const { past, asked } = this.training;
    if (isNews(this, tradeoffs, selected, asking, choosing?.levels, bookmarks, asked, past.length)) {
      const others = robots.map((_, i) => i).filter((i) => i !== selected || asking);
      const marks = (asking ? others : [...others, selected]).map((i) => {
        const outline = robots.length > 1 ? robotColor(i) : "var(--ink)";
        return { weights: robots[i].tradeoff, fill: mixed(robots[i].tradeoff), outline };
      });
      for (const plot of this.plots) plot.show(marks);
      const levels = choosing?.levels ?? {};
      const kept = Object.keys(levels).length ? keeping(engine.about, levels) : null;
      this.map?.limit(asking ? asking.possible : kept);
      this.map?.bound(levels);
      this.map?.pin(bookmarks);
      this.map?.trace(past, asked !== null);
    }
  }

  #showWeights(settled) {
    const { engine, choose } = this;
    const rows = this.names.map((name, i) => {
      const title = `Only ${name}. ${engine.about.notes?.[i] ?? ""}`;
      const act = () => (choose(this.names.map((_, k) => Number(k === i))), settled());
      return { name, limits: [0, 1], color: colorOf(i), format: percent, title, act };
    });
    const move = (index, value) => choose(moved(engine.steered.tradeoff, index, value));
    this.weights = new Sliders($("weights"), rows, move, settled);
  }

  /** Show sliders for numbers with ranges in their section, or hide it; returns them. */
  #showNumbers(id, ranges, format, move, done) {
    $(`${id}-section`).hidden = !ranges;
    if (!ranges) return undefined;
    const look = { color: "var(--ink)", format };
    const rows = Object.entries(ranges).map(([name, limits]) => ({ name, limits, ...look }));
    return new Sliders($(id), rows, move, done);
  }

  #showKinds(about) {
    const { stage, engine } = this;
    const follows = Boolean(about.motion);
    const has = { command: about.velocities, contacts: engine.served, ghost: follows, errors: follows };
    const boxes = [...$("show").querySelectorAll("input")];
    for (const box of boxes) box.parentElement.hidden = !(has[box.name] ?? true);
    $("show").onchange = () => {
      const shown = boxes.filter(({ checked }) => checked).map(({ name }) => name);
      stage.shown = new Set(shown);
      $("errors").hidden = !(follows && stage.shown.isSupersetOf(new Set(["ghost", "errors"])));
    };
    $("show").onchange();
  }

  #showPlots() {
    const { front, names, moments } = this;
    this.plots = this.triangle ? [this.triangle] : [];
    const values = front ? valuesOf(this.engine.about) : [];
    $("axes").hidden = values.length < 3;
    $("front").hidden = $("legend").hidden = !front;
    $("matrix").hidden = !front || names.length < 3;
    $("checkpoint").hidden = Boolean(front);
    if (!front) return;
    explain(front, moments);
    if (isNews(this.lists, values.map(({ index, name }) => [index, name]))) {
      this.axes = front.pair;
      for (const list of this.lists) {
        list.replaceChildren(...values.map(({ name, index }) => new Option(name, index)));
      }
    }
    if (names.length > 2) this.matrix = new Matrix(this.engine.about, (axes) => this.#enlarge(axes));
  }

  /** Show a value on an axis, so that the line of its requirement is seen. */
  #reveal(index) {
    const { maximized } = this.engine.choosing;
    if (!this.axes.includes(index)) this.#enlarge([index, maximized === index ? this.axes[1] : maximized]);
  }

  /** Show two values of the policies, by index, as the large front. */
  #enlarge(axes) {
    this.axes = axes;
    const { choose: pick, choosing, moments } = this;
    const acts = { pick, require: (...level) => choosing.require(...level) };
    this.map = new FrontPlot(this.engine.about, axes, acts, moments);
    axes.forEach((index, i) => (this.lists[i].value = index));
    this.matrix?.choose(axes);
    this.plots = [this.triangle, this.matrix, this.map].filter(Boolean);
    this.facts = null;
  }
}

/** Say what the marks on the front mean. */
function explain({ best, fails, checkpoint, returns }, moments) {
  $("dominated").hidden = best.every((one, i) => one || fails[i]);
  $("failing").hidden = !fails.includes(true);
  $("earlier").hidden = moments.length < 2;
  $("earlier").textContent = returns[0].length === 2 ? "— earlier" : "• earlier";
  $("origin").textContent = `from ${checkpoint}`;
}
