// Lines of the last seconds: returns, velocity and power of the steered robot.

import { $, html, short, svg } from "../pictures.js";
import { colorOf } from "../tradeoffs.js";

const SECONDS = 20;
const [WIDTH, HEIGHT, LEFT] = [380, 84, 50];
const INTERVAL = 0.05; // s between samples

export class Charts {
  constructor(engine) {
    this.engine = engine;
    const { objectives, pushed } = engine.about;
    const along = ["along x", "along y"].slice(0, pushed.length);
    const plain = ["var(--ink)", "var(--faint)"];
    this.charts = [
      { title: "running returns", names: objectives, colors: objectives.map((_, i) => colorOf(i)), of: (r) => r.returns },
      { title: "velocity (m/s)", names: along, colors: plain, of: (r) => r.velocity },
      { title: "mechanical power (W)", names: ["power"], colors: plain, of: (r) => [r.power] },
    ].filter(({ names }) => names.length);
    const drawn = this.charts.map((chart) => {
      const label = `${chart.title} of the last ${SECONDS} s`;
      const look = { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: "chart", role: "img", "aria-label": label };
      chart.drawing = svg("svg", look);
      return html("figure", {}, caption(chart), chart.drawing);
    });
    $("charts").replaceChildren(...drawn);
    this.#forget(null);
  }

  show() {
    const { steered, about, selected } = this.engine;
    if (this.of !== selected) this.#forget(selected);
    const { counted } = steered;
    if (counted < this.counted) this.ends.push(this.time);
    this.time += (counted < this.counted ? counted : counted - this.counted) * about.dt;
    this.counted = counted;
    if (this.time - (this.samples.at(-1)?.time ?? -1) < INTERVAL) return;
    this.samples.push({ time: this.time, values: this.charts.map(({ of }) => [...of(steered)]) });
    while (this.samples[0].time < this.time - SECONDS) this.samples.shift();
    while (this.ends[0] < this.time - SECONDS) this.ends.shift();
    if ($("charts-section").open) this.charts.forEach((chart, i) => this.#draw(chart, i));
  }

  /** Begin anew with a robot. */
  #forget(robot) {
    this.of = robot;
    this.samples = [];
    this.ends = []; // times at which episodes ended
    this.time = 0;
    this.counted = robot === null ? 0 : this.engine.steered.counted;
  }

  #draw({ drawing, names, colors }, index) {
    const rows = this.samples.map(({ values }) => values[index]);
    const all = rows.flat();
    const [low, high] = [Math.min(0, ...all), Math.max(0, ...all) + 1e-9];
    const x = (time) => WIDTH - ((this.time - time) / SECONDS) * (WIDTH - LEFT);
    const y = (value) => HEIGHT - 6 - ((value - low) / (high - low)) * (HEIGHT - 12);
    const lines = names.map((_, k) => {
      let path = "";
      this.samples.forEach(({ time }, i) => {
        const jumps = i === 0 || this.ends.some((end) => end < time && end >= this.samples[i - 1].time);
        path += `${jumps ? "M" : "L"}${x(time).toFixed(1)} ${y(rows[i][k]).toFixed(1)}`;
      });
      return svg("path", { d: path, style: `stroke: ${colors[k]}` });
    });
    const ends = this.ends.map((end) => svg("line", { x1: x(end), x2: x(end), y1: 0, y2: HEIGHT, class: "end-mark" }));
    const scale = [low, high].map((value) => {
      return svg("text", { x: LEFT - 6, y: y(value) + 4, class: "tick", "text-anchor": "end" }, short(value));
    });
    drawing.replaceChildren(...ends, ...lines, ...scale);
  }
}

/** Return the title of a chart, and its lines' names if there are several. */
function caption({ title, names, colors }) {
  const lines = names.length < 2 ? [] : names.map((textContent, k) => {
    return html("span", { className: "dot", textContent, style: `--color: ${colors[k]}` });
  });
  return html("figcaption", {}, title, ...lines);
}
