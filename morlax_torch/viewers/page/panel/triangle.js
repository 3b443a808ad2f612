// The trade-offs of three objectives as a triangle: each corner is one objective alone.

import { $, onArrows, onDrag, svg } from "../pictures.js";
import { colorOf, summary } from "../tradeoffs.js";

const [[AX, AY], [BX, BY], [CX, CY]] = [[160, 22], [51, 211], [269, 211]]; // corners, as in index.html
const PLACES = new DOMMatrix([BX - AX, BY - AY, CX - AX, CY - AY, AX, AY]); // by the last two weights
const WEIGHTS = PLACES.inverse();
const STEP = 8; // of an arrow key

export class Triangle {
  /** @param pick called with the trade-off that a visitor clicks or drags to. */
  constructor(names, pick) {
    Object.assign(this, { names, pick });
    this.element = $("triangle").firstElementChild;
    this.element.ariaLabel = `Trade-off of ${names.join(", ")}: click to choose, or use the arrow keys`;
    this.element.querySelectorAll(".corner").forEach((text, i) => (text.textContent = names[i]));
    [...$("shades").children].forEach((shade, i) => shade.setAttribute("fill", colorOf(i)));
    onDrag(this.element, (place) => this.#choose(place));
    onArrows(this.element, (right, up) => {
      this.#choose([this.place[0] + STEP * right, this.place[1] - STEP * up]);
    });
  }

  /** Mark trade-offs; see `FrontPlot`. */
  show(marks) {
    const circles = marks.map(({ weights, fill, outline }) => {
      const { x: cx, y: cy } = PLACES.transformPoint({ x: weights[1], y: weights[2] });
      this.place = [cx, cy];
      return svg("circle", { cx, cy, r: 8, fill, stroke: outline, class: "mark" });
    });
    $("triangle-marks").replaceChildren(...circles);
    const { weights } = marks.at(-1);
    Object.assign(this.element, { ariaValueNow: weights[0], ariaValueText: summary(weights, this.names) });
  }

  #choose([x, y]) {
    const { x: second, y: third } = WEIGHTS.transformPoint({ x, y });
    const inside = [1 - second - third, second, third].map((w) => Math.max(w, 0));
    const total = inside[0] + inside[1] + inside[2];
    this.pick(inside.map((w) => w / total));
  }
}
