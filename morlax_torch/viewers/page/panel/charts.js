// Lines of the last seconds, of all robots: what they earn, their speed and their power.

import { $, html, short, svg } from "../pictures.js";
import { colorOf, robotColor } from "../tradeoffs.js";
import { present } from "./units.js";

const SECONDS = 20;
const [WIDTH, HEIGHT, LEFT, TOP, BOTTOM] = [380, 92, 50, 6, 18];
const INTERVAL = 0.05; // s between samples

export class Charts {
  constructor(engine, stage, live) {
    Object.assign(this, { engine, stage, live });
    this.hovered = null; // s before the latest sample, which the pointer asks about
    this.#forget();
  }

  show() {
    const { engine, stage } = this;
    const form = `${engine.robots.length} ${present()}`;
    if (form !== this.form || stage.clock * engine.about.dt < this.time) this.#forget();
    this.form = form;
    this.time = stage.clock * engine.about.dt;
    const open = $("charts-section").open;
    if (this.time - (this.samples.at(-1)?.time ?? -1) >= INTERVAL) this.#sample();
    else if (stage.moment === this.moment) return;
    this.moment = stage.moment;
    if (open) this.#draw();
  }

  #forget() {
    this.samples = [];
    this.time = 0;
    const { about, robots } = this.engine;
    const many = robots.length > 1;
    const colors = robots.map((_, i) => (many ? robotColor(i) : "var(--ink)"));
    const each = (of) => robots.map((_, i) => () => of(i));
    const earned = (k) => (i) => {
      return present() === "second" ? this.live.robots[i]?.rates?.[k] : this.engine.robots[i].returns[k];
    };
    const unit = present() === "second" ? "per second" : "of the episode so far";
    const returns = about.titles.map((name, k) => {
      return { title: `${name} ${unit}`, colors: many ? colors : [colorOf(k)], lines: each(earned(k)) };
    });
    this.charts = [
      { title: "speed (m/s)", colors, lines: each((i) => this.live.robots[i]?.speed) },
      { title: "mechanical power (W)", colors, lines: each((i) => this.live.robots[i]?.power) },
      ...returns,
    ];
    const drawn = this.charts.map((chart) => {
      const label = `${chart.title}, in the last ${SECONDS} s`;
      chart.drawing = svg("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: "chart", role: "img", "aria-label": label });
      chart.values = html("span", { className: "values" });
      chart.drawing.addEventListener("pointermove", (event) => this.#hover(event, chart.drawing));
      chart.drawing.addEventListener("pointerleave", () => (this.hovered = null));
      return html("figure", {}, html("figcaption", {}, chart.title, chart.values), chart.drawing);
    });
    $("charts").replaceChildren(...drawn);
  }

  #sample() {
    const began = this.engine.robots.map(({ counted }, i) => counted < (this.samples.at(-1)?.counted[i] ?? 0));
    const counted = this.engine.robots.map((robot) => robot.counted);
    const values = this.charts.map(({ lines }) => lines.map((value) => value() ?? NaN));
    this.samples.push({ time: this.time, values, counted, began });
    while (this.samples[0].time < this.time - SECONDS) this.samples.shift();
  }

  #hover({ clientX }, drawing) {
    const { left, width } = drawing.getBoundingClientRect();
    const x = ((clientX - left) / width) * WIDTH;
    this.hovered = x < LEFT ? null : ((WIDTH - x) / (WIDTH - LEFT)) * SECONDS;
    this.#draw();
  }

  /** Return the seconds before the latest sample that the timeline or the pointer asks about. */
  #asked() {
    const { past, moment } = this.stage;
    if (moment !== null) return this.time - past[moment].clock * this.engine.about.dt;
    return this.hovered;
  }

  #draw() {
    const ago = this.#asked();
    this.charts.forEach((chart, index) => this.#drawOne(chart, index, ago));
  }

  #drawOne({ drawing, colors, lines, values }, index, ago) {
    const rows = this.samples.map((sample) => sample.values[index]);
    const all = rows.flat().filter(Number.isFinite);
    const [low, high] = [Math.min(0, ...all), Math.max(0, ...all) + 1e-9];
    const x = (before) => WIDTH - (before / SECONDS) * (WIDTH - LEFT);
    const y = (value) => HEIGHT - BOTTOM - ((value - low) / (high - low)) * (HEIGHT - TOP - BOTTOM);
    const paths = lines.map((_, k) => {
      let path = "";
      this.samples.forEach(({ time, began }, i) => {
        if (!Number.isFinite(rows[i][k])) return;
        path += `${path === "" || began[k] ? "M" : "L"}${x(this.time - time).toFixed(1)} ${y(rows[i][k]).toFixed(1)}`;
      });
      return svg("path", { d: path, style: `stroke: ${colors[k]}` });
    });
    const scale = [low, high].map((value) => {
      return svg("text", { x: LEFT - 6, y: y(value) + 4, class: "tick", "text-anchor": "end" }, short(value));
    });
    const times = [20, 15, 10, 5, 0].flatMap((before) => [
      svg("line", { x1: x(before), x2: x(before), y1: TOP, y2: HEIGHT - BOTTOM, class: "grid" }),
      svg("text", { x: x(before), y: HEIGHT - 4, class: "tick", "text-anchor": before ? "middle" : "end" }, before ? `−${before} s` : "now"),
    ]);
    const cursor = ago === null ? [] : [svg("line", { x1: x(ago), x2: x(ago), y1: TOP, y2: HEIGHT - BOTTOM, class: "cursor" })];
    drawing.replaceChildren(...times, ...paths, ...scale, ...cursor);
    const at = ago === null ? this.samples.length - 1 : this.samples.findLastIndex(({ time }) => time <= this.time - ago);
    const dots = (rows[at] ?? []).map((value, k) => {
      const textContent = Number.isFinite(value) ? short(value) : "–";
      return html("span", { className: "dot", textContent, style: `--color: ${colors[k]}` });
    });
    values.replaceChildren(...dots);
  }
}
