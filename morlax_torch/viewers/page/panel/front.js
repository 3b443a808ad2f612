// The map of policies: two of their values against each other, and every point is a trade-off.

import { $, dotted, grid, html, lined, onArrows, onDrag, percent, scale, short, svg, ticks } from "../pictures.js";
import { distance, lowest, mixed, nearest } from "../tradeoffs.js";
import { inUnit, named, ofEpisode, valuesOf } from "../values.js";

const [WIDTH, HEIGHT] = [380, 268];
const [LEFT, RIGHT, TOP, BOTTOM] = [50, 368, 10, 232]; // of the axes
const SPANS = [[LEFT, RIGHT], [BOTTOM, TOP]];
const NEAR = 14; // from the pointer to a point that it asks about
const GRIP = 9; // from the pointer to a line or bookmark that it takes
const APART = 9; // between the rings of robots that would coincide
const BETWEEN = 0.006; // a weight's distance, from which on a trade-off is not the evaluated one

export class FrontPlot {
  /**
   * Show two values of the policies, by index. `pick` is called with the trade-off that a visitor
   * chooses, `require` with index and level of a requirement that he or she moves. There is room
   * for the fronts of all `moments` of training.
   */
  constructor(about, axes, { pick, require }, moments) {
    Object.assign(this, { about, pick, require, front: about.front, held: null, levels: {} });
    const values = valuesOf(about);
    this.axes = axes.map((index) => values.find((value) => value.index === index));
    this.columns = this.axes.map((axis) => axis.values.map((value) => inUnit(axis, value, about)));
    const standing = indicesOf(this.front.fails.map((fails) => !fails)); // a fall may lie far away
    const before = moments.flatMap(({ values }) => values).map((row) => this.#inUnits(row));
    this.ranges = this.columns.map((column, k) => {
      const shown = standing.length ? standing.map((i) => column[i]) : column;
      return paddedRange([...shown, ...before.map((row) => row[k]).filter(Number.isFinite)]);
    });
    this.places = this.front.tradeoffs.map((_, i) => this.columns.map((column, k) => this.#along(k, column[i])));
    this.along = indicesOf(this.front.best).sort((a, b) => this.places[a][0] - this.places[b][0]);
    this.nearest = 0;
    this.#drawScales();
    this.#drawPoints();
    this.drawing = $("front").firstElementChild;
    this.drawing.ariaLabel = `Pareto front of ${this.axes.map(named).join(" and ")}: click, or use the arrow keys`;
    onDrag(this.drawing, (place, begins) => this.#choose(place, begins), (place) => this.#point(place));
    this.drawing.onpointerup = () => this.#release();
    this.drawing.onpointerleave = () => ($("tip").hidden = true);
    onArrows(this.drawing, (right, up) => this.#step(right + up));
    $("tip").hidden = true;
  }

  /** Mark the evaluated trade-offs that are nearest to given ones; the last is the visitor's own. */
  show(marks) {
    const points = marks.map(({ weights }) => nearest(this.front.tradeoffs, weights));
    let isBetween = false;
    const circles = marks.map(({ weights, fill, outline }, i) => {
      const point = (this.nearest = points[i]);
      const same = points.flatMap((other, k) => (other === point ? [k] : []));
      const shift = APART * (same.indexOf(i) - (same.length - 1) / 2);
      const [x, cy] = this.places[point];
      isBetween = this.front.tradeoffs[point].some((w, k) => Math.abs(w - weights[k]) > BETWEEN);
      const look = isBetween ? "mark between" : "mark";
      return svg("circle", { cx: x + shift, cy, r: 7.5, fill, stroke: outline, class: look });
    });
    const [x, y] = this.places[this.nearest];
    const look = { ...beside(x, 12), y: y > HEIGHT / 2 ? y - 9 : y + 16, class: "readout told" };
    const told = isBetween ? [svg("text", look, "between evaluated policies")] : [];
    $("marks").replaceChildren(...circles, ...told);
    const ariaValueText = this.#facts(this.nearest).join(", ");
    Object.assign(this.drawing, { ariaValueNow: this.nearest, ariaValueText });
  }

  /** Draw the fronts of moments of training faintly, the last one of which may be `asked` for. */
  trace(moments, asked) {
    const drawn = moments.map(({ values, tradeoffs }, i) => {
      const rows = values.map((row, k) => [this.#inUnits(row), tradeoffs[k]]);
      const known = rows.filter(([row]) => row.every(Number.isFinite));
      const places = known.map(([row, weights]) => [row.map((value, k) => this.#along(k, value)), weights]);
      if (asked && i === moments.length - 1) {
        return places.map(([[cx, cy], weights]) => svg("circle", { cx, cy, r: 3.4, fill: mixed(weights) }));
      }
      const sorted = places.map(([place]) => place).sort((a, b) => a[0] - b[0]);
      const isLine = this.about.objectives.length === 2 && this.axes.every(({ physical }) => !physical);
      const d = isLine ? lined(sorted) : dotted(sorted);
      return [svg("path", { d, class: isLine ? "earlier" : "earlier dots" })];
    });
    $("past").replaceChildren(...drawn.flat());
    this.drawing.classList.toggle("looks-back", asked);
  }

  /** Return the values of a row on both axes, in the present unit; NaN: unknown. */
  #inUnits(row) {
    return this.axes.map((axis) => inUnit(axis, row[axis.index] ?? NaN, this.about));
  }

  /** Let only some points stand out, by index; null: all. */
  limit(points) {
    const chosen = points === null ? null : new Set(points);
    for (const [i, point] of this.points) point.classList.toggle("out", chosen !== null && !chosen.has(i));
  }

  /** Draw the levels that are required, by index of the value, unless the visitor holds one. */
  bound(levels) {
    if (this.held !== null) return;
    this.levels = levels;
    this.#drawLines();
  }

  /** Mark bookmarks, which are trade-offs by name. */
  pin(bookmarks) {
    this.kept = Object.entries(bookmarks ?? {}).map(([name, weights]) => {
      return { name, weights, place: this.places[nearest(this.front.tradeoffs, weights)] };
    });
    const pins = this.kept.flatMap(({ name, place: [x, y] }) => {
      return [
        svg("path", { d: `M${x} ${y - 6}l5 6l-5 6l-5-6z`, class: "pin" }),
        svg("text", { ...beside(x, 8), y: y - 7, class: "pin-name" }, `@${name}`),
      ];
    });
    $("pins").replaceChildren(...pins);
  }

  #choose(place, begins) {
    if (begins) this.held = [0, 1].find((k) => Math.abs(this.#lineAt(k) - place[k]) < GRIP) ?? null; // an axis
    if (this.held !== null) {
      const [axis, range] = [this.axes[this.held], this.ranges[this.held]];
      const value = clamped(scale(SPANS[this.held], range)(place[this.held]), range);
      this.levels = { ...this.levels, [axis.index]: ofEpisode(axis, value, this.about) };
      this.#drawLines();
      return;
    }
    const pin = this.kept?.find((one) => distance(one.place, place) < GRIP ** 2);
    const point = this.along[lowest(this.along, (i) => distance(this.places[i], place))];
    this.#tell(point);
    this.pick(pin?.weights ?? this.front.tradeoffs[point]);
  }

  /** Require the level of the line that the visitor lets go of. */
  #release() {
    if (this.held === null) return;
    const { index } = this.axes[this.held];
    this.held = null;
    this.require(index, this.levels[index]);
  }

  /** Return where the line of an axis lies; NaN: nothing is required of it. */
  #lineAt(k) {
    const axis = this.axes[k];
    return this.#along(k, inUnit(axis, this.levels[axis.index] ?? NaN, this.about));
  }

  #drawLines() {
    const parts = [0, 1].flatMap((k) => {
      const [axis, at] = [this.axes[k], this.#lineAt(k)];
      if (Number.isNaN(at)) return [];
      const level = short(inUnit(axis, this.levels[axis.index], this.about));
      const end = SPANS[k][axis.lower ? 1 : 0]; // of what is ruled out
      const [line, out] = k === 0
        ? [`M${at} ${TOP}V${BOTTOM}`, `M${at} ${TOP}V${BOTTOM}H${end}V${TOP}`]
        : [`M${LEFT} ${at}H${RIGHT}`, `M${LEFT} ${at}H${RIGHT}V${end}H${LEFT}`];
      const across = { x: RIGHT - 4, y: at > HEIGHT / 2 ? at - 5 : at + 15, "text-anchor": "end" };
      const place = k === 0 ? { ...beside(at, 5), y: TOP + 11 } : across;
      return [
        svg("path", { d: out, class: "ruled-out" }),
        svg("path", { d: line, class: "threshold" }),
        svg("text", { ...place, class: "readout" }, `${axis.lower ? "≤" : "≥"} ${level}`),
      ];
    });
    $("thresholds").replaceChildren(...parts);
  }

  /** Tell the point under the pointer, if there is one. */
  #point(place) {
    const point = lowest(this.places, (other) => distance(other, place));
    if (distance(this.places[point], place) > NEAR ** 2) $("tip").hidden = true;
    else this.#tell(point);
  }

  /** Return which trade-off a point has, and what its policy earns. */
  #facts(point) {
    const { tradeoffs, falls } = this.front;
    const lines = this.axes.map((axis, i) => {
      const weight = axis.physical ? "" : ` (weight ${percent(tradeoffs[point][axis.index])})`;
      return `${named(axis)}: ${short(this.columns[i][point])}${weight}`;
    });
    if (falls[point]) lines.push(`falls in ${percent(falls[point])} of its episodes`);
    return lines;
  }

  /** Show the facts of a point beside it. */
  #tell(point) {
    $("tip").hidden = false;
    $("tip").replaceChildren(...this.#facts(point).map((textContent) => html("span", { textContent })));
    const [x, y] = this.places[point];
    $("tip").style.cssText = `--x: ${x / WIDTH}; --y: ${y / HEIGHT}`;
  }

  /** Move along the front. */
  #step(way) {
    const here = lowest(this.along, (i) => distance(this.places[i], this.places[this.nearest]));
    const next = Math.min(Math.max(here + way, 0), this.along.length - 1);
    this.nearest = this.along[next]; // further keys may come before the next frame
    this.pick(this.front.tradeoffs[this.nearest]);
  }

  /** Return where a value lies along an axis; at an end if it is out of range. */
  #along(k, value) {
    return scale(this.ranges[k], SPANS[k])(clamped(value, this.ranges[k]));
  }

  #drawPoints() {
    const { best, fails, tradeoffs } = this.front;
    const order = this.places.map((_, i) => i).sort((a, b) => best[a] - best[b]);
    const draw = (i) => {
      const [cx, cy] = this.places[i];
      if (fails[i]) return svg("path", { d: `M${cx - 3} ${cy - 3}l6 6m0-6l-6 6`, class: "failed" });
      if (!best[i]) return svg("circle", { cx, cy, r: 1.8, class: "dominated" });
      return svg("circle", { cx, cy, r: 3.4, fill: mixed(tradeoffs[i]) });
    };
    this.points = order.map((i) => [i, draw(i)]);
    $("points").replaceChildren(...this.points.map(([, point]) => point));
  }

  #drawScales() {
    const marks = this.ranges.map((range, k) => ticks(...range).map((value) => [this.#along(k, value), short(value)]));
    const [x, y] = [(LEFT + RIGHT) / 2, (TOP + BOTTOM) / 2];
    const [across, up] = this.axes.map((axis) => {
      return axis.lower ? `← better · ${named(axis)}` : `${named(axis)} · better →`;
    });
    const look = { class: "axis", "text-anchor": "middle" };
    $("scales").replaceChildren(
      ...grid([LEFT, RIGHT, TOP, BOTTOM], ...marks),
      svg("text", { x, y: HEIGHT - 4, ...look }, across),
      svg("text", { transform: `translate(11 ${y}) rotate(-90)`, ...look }, up),
    );
  }
}

const clamped = (value, [low, high]) => Math.min(Math.max(value, low), high);

/** Return where a text beside a place begins or ends, so that it stays on the drawing. */
const beside = (x, gap) => (x > WIDTH / 2 ? { x: x - gap, "text-anchor": "end" } : { x: x + gap });

const indicesOf = (flags) => flags.flatMap((flag, i) => (flag ? [i] : []));

function paddedRange(values) {
  const [low, high] = [Math.min(...values), Math.max(...values)];
  const margin = Math.max(0.06 * (high - low), 1e-6 + 1e-6 * Math.abs(high));
  return [low - margin, high + margin];
}
