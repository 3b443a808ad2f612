// The trade-offs of three objectives as a triangle: each corner is one objective alone.

import { $, onDrag, svg } from "../pictures.js";
import { colorOf, summary } from "../tradeoffs.js";

const CORNERS = [[160, 22], [51, 211], [269, 211]]; // all sides equally long
const WAYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const STEP = 8; // of an arrow key

export class Triangle {
  /** @param pick called with the trade-off that a visitor clicks or drags to. */
  constructor(names, pick) {
    Object.assign(this, { names, pick });
    this.element = $("triangle").firstElementChild;
    this.element.ariaLabel = `Trade-off of ${names.join(", ")}: click to choose, or use the arrow keys`;
    this.element.querySelectorAll(".corner").forEach((text, i) => (text.textContent = names[i]));
    $("shades").replaceChildren(...CORNERS.flatMap(shade));
    $("edge").setAttribute("points", CORNERS.join(" "));
    onDrag(this.element, (place) => this.#choose(place));
    this.element.onkeydown = (event) => {
      const [x, y] = WAYS[event.key] ?? [];
      if (x === undefined) return;
      event.preventDefault();
      this.#choose([this.place[0] + STEP * x, this.place[1] + STEP * y]);
    };
  }

  /** Mark trade-offs; see `FrontPlot`. */
  show(marks) {
    const circles = marks.map(({ weights, fill, outline }) => {
      const [cx, cy] = (this.place = at(weights));
      return svg("circle", { cx, cy, r: 8, fill, stroke: outline, class: "mark" });
    });
    $("triangle-marks").replaceChildren(...circles);
    const { weights } = marks.at(-1);
    Object.assign(this.element, { ariaValueNow: weights[0], ariaValueText: summary(weights, this.names) });
  }

  #choose(place) {
    const inside = weightsAt(place).map((w) => Math.max(w, 0));
    const total = inside[0] + inside[1] + inside[2];
    this.pick(inside.map((w) => w / total));
  }
}

function at(weights) {
  return [0, 1].map((axis) => CORNERS.reduce((sum, corner, i) => sum + weights[i] * corner[axis], 0));
}

/** Return the weights of the corners at a point: its barycentric coordinates. */
function weightsAt([x, y]) {
  const [[ax, ay], [bx, by], [cx, cy]] = CORNERS;
  const area = (by - cy) * (ax - cx) + (cx - bx) * (ay - cy);
  const a = ((by - cy) * (x - cx) + (cx - bx) * (y - cy)) / area;
  const b = ((cy - ay) * (x - cx) + (ax - cx) * (y - cy)) / area;
  return [a, b, 1 - a - b];
}

/** Fill the triangle with an objective's color, as strong as its weight; the colors of all add up. */
function shade([x1, y1], corner) {
  const others = CORNERS.toSpliced(corner, 1);
  const [x2, y2] = [0, 1].map((axis) => (others[0][axis] + others[1][axis]) / 2);
  const ends = [1, 0].map((opacity) => {
    return svg("stop", { offset: 1 - opacity, "stop-color": colorOf(corner), "stop-opacity": opacity });
  });
  const id = `shade-${corner}`;
  const style = "mix-blend-mode: plus-lighter";
  return [
    svg("linearGradient", { id, gradientUnits: "userSpaceOnUse", x1, y1, x2, y2 }, ...ends),
    svg("polygon", { points: CORNERS.join(" "), fill: `url(#${id})`, style }),
  ];
}
