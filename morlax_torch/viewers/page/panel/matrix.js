// Small fronts of all pairs of objectives, each of which a visitor can enlarge.

import { $, dotted, html, svg } from "../pictures.js";
import { colorOf, mixed, nearest } from "../tradeoffs.js";

const [WIDTH, HEIGHT, MARGIN] = [100, 64, 6];

export class Matrix {
  /** @param enlarge called with the two objectives of a small front, by index. */
  constructor({ titles, front }, enlarge) {
    this.front = front;
    const m = titles.length;
    this.radius = 1.7 * (m - 1); // about 5 pixels
    this.cells = [];
    $("matrix").replaceChildren();
    $("matrix").style.gridTemplateColumns = `repeat(${m - 1}, minmax(0, 1fr)) auto`;
    titles.forEach((title, up) => {
      for (let across = 0; across < up; across++) {
        const label = `${title} against ${titles[across]}`;
        const button = html("button", { type: "button", title: label, ariaLabel: label });
        button.style.gridArea = `${up + 1} / ${across + 1}`;
        button.addEventListener("click", () => enlarge([across, up]));
        this.cells.push(this.#drawn(button, across, up));
        $("matrix").append(button);
      }
      const name = html("span", { className: "dot", textContent: title });
      name.style.cssText = `--color: ${colorOf(up)}; grid-area: ${up + 1} / ${up + 1}`;
      if (up < m - 1) name.style.gridColumnEnd = -1;
      $("matrix").append(name);
    });
  }

  choose(axes) {
    for (const { button, pair } of this.cells) {
      button.setAttribute("aria-pressed", pair.every((index) => axes.includes(index)));
    }
  }

  /** Mark trade-offs; see `FrontPlot`. */
  show(marks) {
    const points = marks.map(({ weights }) => nearest(this.front.tradeoffs, weights));
    for (const { rings, at } of this.cells) {
      const circles = marks.map(({ fill, outline }, i) => {
        const [cx, cy] = at(points[i]);
        return svg("circle", { cx, cy, r: this.radius, fill, stroke: outline, class: "mark" });
      });
      rings.replaceChildren(...circles);
    }
  }

  /** Draw the policies of a pair: one path for each color, since there may be thousands. */
  #drawn(button, across, up) {
    const { returns, tradeoffs, best } = this.front;
    const scaled = (k, size) => {
      const column = returns.map((row) => row[k]);
      const front = column.filter((_, i) => best[i]);
      const [low, high] = [Math.min(...front), Math.max(...front)];
      const share = (value) => Math.min(Math.max((value - low) / (high - low || 1), 0), 1);
      return (i) => MARGIN + share(column[i]) * (size - 2 * MARGIN);
    };
    const [x, y] = [scaled(across, WIDTH), scaled(up, HEIGHT)];
    const at = (i) => [x(i), HEIGHT - y(i)];
    const color = (i) => (best[i] ? mixed(tradeoffs[i].map((w) => Math.round(4 * w) / 4)) : "var(--line)");
    const paths = [...Map.groupBy(tradeoffs.keys(), color)].map(([stroke, policies]) => {
      return svg("path", { d: dotted(policies.map(at)), stroke, class: "dots" });
    });
    const rings = svg("g");
    button.append(svg("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}` }, ...paths, rings));
    return { button, rings, at, pair: [across, up] };
  }
}
