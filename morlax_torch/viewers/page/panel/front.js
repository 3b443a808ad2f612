// The map of policies: two objectives against each other, and every point is a trade-off to pick.

import { html, onDrag, percent, short, svg, ticks } from "../pictures.js";
import { mixed } from "../tradeoffs.js";

const [WIDTH, HEIGHT] = [380, 300];
const [LEFT, RIGHT, TOP, BOTTOM] = [50, 12, 12, 40]; // margins
const NEAR = 14; // from the pointer to a point that it asks about

export class FrontPlot {
  /** Show two axes of a front, by index; `pick` is called with the trade-off that a visitor chooses. */
  constructor(front, names, axes, pick) {
    Object.assign(this, { front, names, axes, pick });
    this.ranges = axes.map((i) => paddedRange(front.values.map((v) => v[i])));
    this.places = front.values.map((v) => this.#at(axes.map((i) => v[i])));
    this.along = indicesOf(front.best).sort((a, b) => this.places[a][0] - this.places[b][0]);
    this.marks = svg("g");
    this.nearest = 0;
    const label = `Pareto front of ${axes.map((i) => front.axes[i]).join(" and ")}: click, or use the arrow keys`;
    this.drawing = svg(
      "svg",
      { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: "plot", role: "img", tabindex: 0, "aria-label": label },
      ...this.#scales(),
      ...this.#points(),
      this.marks,
    );
    this.tip = html("p", { className: "tip", hidden: true });
    this.element = html("div", { className: "map" }, this.drawing, this.tip);
    onDrag(this.drawing, (place) => this.#choose(place), (place) => this.#point(place));
    this.drawing.addEventListener("pointerleave", () => (this.tip.hidden = true));
    this.drawing.addEventListener("keydown", (event) => this.#step(event));
  }

  /** Mark the evaluated trade-offs that are nearest to given ones; the last is the visitor's own. */
  show(marks) {
    const circles = marks.map(({ weights, fill, outline }) => {
      this.nearest = lowest(this.front.tradeoffs, (w) => distance(w, weights));
      const [cx, cy] = this.places[this.nearest];
      return svg("circle", { cx, cy, r: 7.5, fill, stroke: outline, class: "mark" });
    });
    this.marks.replaceChildren(...circles);
  }

  /** Let only some points stand out, by index; null: all. */
  limit(points) {
    const chosen = points === null ? null : new Set(points);
    for (const [i, point] of this.points) point.classList.toggle("out", chosen !== null && !chosen.has(i));
  }

  #choose(place) {
    const far = (other, i) => (this.front.best[i] ? distance(other, place) : Infinity);
    const point = lowest(this.places, far);
    this.#tell(point);
    this.pick(this.front.tradeoffs[point]);
  }

  /** Tell the point under the pointer, if there is one. */
  #point(place) {
    const point = lowest(this.places, (other) => distance(other, place));
    if (distance(this.places[point], place) > NEAR ** 2) this.tip.hidden = true;
    else this.#tell(point);
  }

  /** Say which trade-off a point has, and what its policy earns. */
  #tell(point) {
    this.tip.hidden = false;
    const { tradeoffs, axes, values, falls } = this.front;
    const lines = axes.map((axis, i) => {
      if (i >= this.names.length) return `${axis}: ${short(values[point][i])}`;
      const weight = percent(tradeoffs[point][i]);
      return `${this.names[i]} ${weight}: ${short(values[point][i])} per second`;
    });
    if (falls[point]) lines.push(`falls in ${percent(falls[point])} of its episodes`);
    this.tip.replaceChildren(...lines.map((text) => html("span", { textContent: text })));
    const [x, y] = this.places[point];
    const late = x > WIDTH / 2;
    this.tip.style.left = late ? "auto" : `${(100 * x) / WIDTH}%`;
    this.tip.style.right = late ? `${100 - (100 * x) / WIDTH}%` : "auto";
    this.tip.style.top = `${(100 * (y + 10)) / HEIGHT}%`;
  }

  /** Move along the front with the arrow keys. */
  #step(event) {
    const way = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 }[event.key];
    if (!way) return;
    event.preventDefault();
    const here = lowest(this.along, (i) => distance(this.places[i], this.places[this.nearest]));
    const next = Math.min(Math.max(here + way, 0), this.along.length - 1);
    this.nearest = this.along[next]; // further keys may come before the next frame
    this.pick(this.front.tradeoffs[this.nearest]);
  }

  #at([x, y]) {
    const [[left, right], [bottom, top]] = this.ranges;
    return [
      LEFT + ((x - left) / (right - left)) * (WIDTH - LEFT - RIGHT),
      HEIGHT - BOTTOM - ((y - bottom) / (top - bottom)) * (HEIGHT - TOP - BOTTOM),
    ];
  }

  #points() {
    const { best, fails, tradeoffs } = this.front;
    const order = this.places.map((_, i) => i).sort((a, b) => best[a] - best[b]);
    const draw = (i) => {
      const [cx, cy] = this.places[i];
      if (fails[i]) return svg("path", { d: `M${cx - 3} ${cy - 3}l6 6m0-6l-6 6`, class: "failed" });
      if (!best[i]) return svg("circle", { cx, cy, r: 1.8, class: "dominated" });
      return svg("circle", { cx, cy, r: 3.4, fill: mixed(tradeoffs[i]) });
    };
    this.points = order.map((i) => [i, draw(i)]);
    return this.points.map(([, point]) => point);
  }

  #scales() {
    const parts = [];
    const [[left, right], [bottom, top]] = this.ranges;
    for (const value of ticks(left, right)) {
      const [x] = this.#at([value, bottom]);
      parts.push(svg("line", { x1: x, x2: x, y1: TOP, y2: HEIGHT - BOTTOM, class: "grid" }));
      parts.push(svg("text", { x, y: HEIGHT - BOTTOM + 15, class: "tick", "text-anchor": "middle" }, short(value)));
    }
    for (const value of ticks(bottom, top)) {
      const [, y] = this.#at([left, value]);
      parts.push(svg("line", { x1: LEFT, x2: WIDTH - RIGHT, y1: y, y2: y, class: "grid" }));
      parts.push(svg("text", { x: LEFT - 6, y: y + 3.5, class: "tick", "text-anchor": "end" }, short(value)));
    }
    const [x, y] = [(LEFT + WIDTH - RIGHT) / 2, (TOP + HEIGHT - BOTTOM) / 2];
    const [across, up] = this.axes.map((i) => this.front.axes[i]);
    const look = { class: "axis", "text-anchor": "middle" };
    parts.push(svg("text", { x, y: HEIGHT - 6, ...look }, across));
    parts.push(svg("text", { transform: `translate(11 ${y}) rotate(-90)`, ...look }, up));
    return parts;
  }
}

const indicesOf = (flags) => flags.flatMap((flag, i) => (flag ? [i] : []));

function paddedRange(values) {
  const [low, high] = [Math.min(...values), Math.max(...values)];
  const margin = Math.max(0.06 * (high - low), 1e-6 + 1e-6 * Math.abs(high));
  return [low - margin, high + margin];
}

/** Return the squared distance of two points. */
const distance = (a, b) => a.reduce((sum, x, i) => sum + (x - b[i]) ** 2, 0);

/** Return the index of the item with the lowest score. */
function lowest(items, score) {
  const scores = items.map(score);
  return scores.indexOf(Math.min(...scores));
}
