// Lines of the last seconds, of all robots: what they earn, their speed and their power.

import { $, grid, html, onDrag, scale, short, svg } from "../pictures.js";
import { robotColor } from "../tradeoffs.js";
import { present } from "../values.js";

const SECONDS = 20;
const [LEFT, RIGHT, TOP, BOTTOM] = [50, 366, 6, 74]; // of the axes
const INTERVAL = 0.05; // s between samples
const across = scale([SECONDS, 0], [LEFT, RIGHT]); // from seconds before the latest sample

export class Charts {
  constructor(engine, stage, live) {
    Object.assign(this, { engine, stage, live });
    this.hovered = null; // s before the latest sample, which the pointer asks about
    this.#forget();
    $("charts-section").ontoggle = () => this.#draw(); // also of a robot that is paused
  }

  show() {
    const { engine, stage } = this;
    const form = `${engine.robots.length} ${present()}`;
    if (form !== this.form || stage.clock * engine.about.dt < this.time) this.#forget();
    this.form = form;
    this.time = stage.clock * engine.about.dt;
    if (this.time - (this.samples.at(-1)?.time ?? -1) >= INTERVAL) this.#sample();
    else if (stage.moment === this.moment) return;
    this.moment = stage.moment;
    if ($("charts-section").open) this.#draw();
  }

  #forget() {
    this.samples = [];
    this.time = 0;
    const { robots } = this.engine;
    const many = robots.length > 1;
    const unit = present() === "second" ? "per second" : "of the episode so far";
    this.charts = this.live.numbers.map(({ name, index, color, now }) => {
      const title = index === undefined ? name : `${name} ${unit}`;
      return { title, now, colors: robots.map((_, i) => (many ? robotColor(i) : color)) };
    });
    const hover = ([x]) => {
      this.hovered = x < LEFT ? null : scale([LEFT, RIGHT], [SECONDS, 0])(x);
      this.#draw();
    };
    const drawn = this.charts.map((chart) => {
      const label = `${chart.title}, in the last ${SECONDS} s`;
      chart.drawing = svg("svg", { viewBox: "0 0 380 92", class: "chart", role: "img", "aria-label": label });
      chart.values = html("span", { className: "values" });
      onDrag(chart.drawing, hover, hover);
      chart.drawing.addEventListener("pointerleave", () => (this.hovered = null));
      return html("figure", {}, html("figcaption", {}, chart.title, chart.values), chart.drawing);
    });
    $("charts").replaceChildren(...drawn);
  }

  #sample() {
    const began = this.engine.robots.map(({ counted }, i) => counted < (this.samples.at(-1)?.counted[i] ?? 0));
    const counted = this.engine.robots.map((robot) => robot.counted);
    const values = this.charts.map(({ now }) => this.engine.robots.map((_, i) => now(i) ?? NaN));
    this.samples.push({ time: this.time, values, counted, began });
    while (this.samples[0].time < this.time - SECONDS) this.samples.shift();
  }

  #draw() {
    const { past, moment } = this.stage;
    // seconds before the latest sample that the timeline or the pointer asks about
    const ago = moment === null ? this.hovered : this.time - past[moment].clock * this.engine.about.dt;
    this.charts.forEach((chart, index) => this.#drawOne(chart, index, ago));
  }

  #drawOne({ drawing, colors, values }, index, ago) {
    const rows = this.samples.map((sample) => sample.values[index]);
    const all = rows.flat().filter(Number.isFinite);
    const [low, high] = [Math.min(0, ...all), Math.max(0, ...all) + 1e-9];
    const y = scale([low, high], [BOTTOM, TOP]);
    const paths = colors.map((_, k) => {
      let path = "";
      this.samples.forEach(({ time, began }, i) => {
        if (!Number.isFinite(rows[i][k])) return;
        path += `${path === "" || began[k] ? "M" : "L"}${across(this.time - time).toFixed(1)} ${y(rows[i][k]).toFixed(1)}`;
      });
      return svg("path", { d: path, style: `stroke: ${colors[k]}` });
    });
    const times = [20, 15, 10, 5, 0].map((before) => [across(before), before ? `−${before} s` : "now"]);
    const axes = grid([LEFT, RIGHT, TOP, BOTTOM], times, [low, high].map((value) => [y(value), short(value)]));
    const cursor = ago === null ? [] : [svg("line", { x1: across(ago), x2: across(ago), y1: TOP, y2: BOTTOM, class: "cursor" })];
    drawing.replaceChildren(...axes, ...paths, ...cursor);
    const at = ago === null ? this.samples.length - 1 : this.samples.findLastIndex(({ time }) => time <= this.time - ago);
    const dots = (rows[at] ?? []).map((value, k) => {
      const textContent = Number.isFinite(value) ? short(value) : "–";
      return html("span", { className: "dot", textContent, style: `--color: ${colors[k]}` });
    });
    values.replaceChildren(...dots);
  }
}
