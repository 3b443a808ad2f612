// The returns of two objectives against each other: every point is a trade-off to pick.

import { onDrag, short, svg, ticks } from "./pictures.js";
import { mixed } from "./weights.js";

const [WIDTH, HEIGHT] = [320, 220];
const [LEFT, RIGHT, TOP, BOTTOM] = [52, 10, 10, 38]; // margins

export class FrontPlot {
  /**
   * @param front tradeoffs, returns and which are best.
   * @param names of all objectives.
   * @param axes indices of the two objectives to show.
   * @param pick called with a trade-off that a visitor clicks or drags to.
   */
  constructor(front, names, axes, pick) {
    Object.assign(this, { front, axes, pick });
    this.ranges = axes.map((i) => paddedRange(front.returns.map((r) => r[i])));
    this.places = front.returns.map((r) => this.#at(axes.map((i) => r[i])));
    this.mark = svg("circle", { r: 6.5, class: "mark" });
    const label = `Pareto front of ${axes.map((i) => names[i]).join(" and ")}: click to choose`;
    this.element = svg(
      "svg",
      { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: "plot", role: "img", "aria-label": label },
      ...this.#scales(names),
      ...this.#points(),
      this.mark,
    );
    onDrag(this.element, (place) => this.#choose(place));
  }

  /** Mark where a trade-off lies: at the evaluated one that is nearest. */
  show(weights) {
    const nearest = lowest(this.front.tradeoffs, (w) => distance(w, weights));
    const [x, y] = this.places[nearest];
    this.mark.setAttribute("cx", x);
    this.mark.setAttribute("cy", y);
    this.mark.setAttribute("fill", mixed(weights));
  }

  #choose(place) {
    const far = (other, i) => (this.front.best[i] ? distance(other, place) : Infinity);
    this.pick(this.front.tradeoffs[lowest(this.places, far)]);
  }

  #at([x, y]) {
    const [[left, right], [bottom, top]] = this.ranges;
    return [
      LEFT + ((x - left) / (right - left)) * (WIDTH - LEFT - RIGHT),
      HEIGHT - BOTTOM - ((y - bottom) / (top - bottom)) * (HEIGHT - TOP - BOTTOM),
    ];
  }

  #points() {
    const order = this.places.map((_, i) => i).sort((a, b) => this.front.best[a] - this.front.best[b]);
    return order.map((i) => {
      const [cx, cy] = this.places[i];
      if (!this.front.best[i]) return svg("circle", { cx, cy, r: 1.6, class: "dominated" });
      return svg("circle", { cx, cy, r: 2.8, fill: mixed(this.front.tradeoffs[i]) });
    });
  }

  #scales(names) {
    const parts = [];
    const [[left, right], [bottom, top]] = this.ranges;
    for (const value of ticks(left, right)) {
      const [x] = this.#at([value, bottom]);
      parts.push(svg("line", { x1: x, x2: x, y1: TOP, y2: HEIGHT - BOTTOM, class: "grid" }));
      parts.push(svg("text", { x, y: HEIGHT - BOTTOM + 14, class: "tick middle" }, short(value)));
    }
    for (const value of ticks(bottom, top)) {
      const [, y] = this.#at([left, value]);
      parts.push(svg("line", { x1: LEFT, x2: WIDTH - RIGHT, y1: y, y2: y, class: "grid" }));
      parts.push(svg("text", { x: LEFT - 6, y: y + 3.5, class: "tick end" }, short(value)));
    }
    const [x, y] = [(LEFT + WIDTH - RIGHT) / 2, (TOP + HEIGHT - BOTTOM) / 2];
    const [across, up] = this.axes.map((i) => `${names[i]} (return)`);
    parts.push(svg("text", { x, y: HEIGHT - 6, class: "axis middle" }, across));
    const turned = `translate(11 ${y}) rotate(-90)`;
    parts.push(svg("text", { transform: turned, class: "axis middle" }, up));
    return parts;
  }
}

function paddedRange(values) {
  const [low, high] = [Math.min(...values), Math.max(...values)];
  const margin = Math.max(0.06 * (high - low), 1e-6 + 1e-6 * Math.abs(high));
  return [low - margin, high + margin];
}

/** Return the squared distance of two points. */
function distance(a, b) {
  return a.reduce((sum, x, i) => sum + (x - b[i]) ** 2, 0);
}

/** Return the index of the item with the lowest score. */
function lowest(items, score) {
  let best = 0;
  let least = Infinity;
  items.forEach((item, i) => {
    const found = score(item, i);
    if (found < least) [best, least] = [i, found];
  });
  return best;
}
