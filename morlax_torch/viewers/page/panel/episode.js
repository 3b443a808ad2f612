// Returns of the running episode, and how the former one ended.

import { $, html, short } from "../pictures.js";
import { colorOf, robotColor } from "../tradeoffs.js";

const CALM = 0.05; // share of a new reward in the smoothed one

export class Episode {
  constructor(engine) {
    this.engine = engine;
    const { terms } = engine.about;
    $("terms-section").hidden = !terms?.length;
    this.termCells = (terms ?? []).map(() => html("td"));
    const rows = this.termCells.map((cell, i) => html("tr", {}, html("th", { textContent: terms[i] }), cell));
    $("terms").replaceChildren(...rows);
  }

  show() {
    const { robots, about, selected, steered } = this.engine;
    if (robots.length !== this.number) this.#tabulate(robots.length, about.objectives);
    robots.forEach((robot, i) => {
      robot.returns.forEach((value, k) => (this.cells[k][i].textContent = amount(value)));
    });
    if (robots.length === 1) this.#showRates(steered, about.dt);
    this.termCells.forEach((cell, i) => {
      cell.textContent = steered.terms ? amount(steered.terms[i]) : "–";
    });
    const { ended } = robots[selected];
    const sums = about.objectives.map((name, i) => `${name} ${amount(ended?.returns[i] ?? 0)}`).join(", ");
    $("ended").textContent = ended
      ? `The last episode ${ended.fell ? "failed" : "ended"} after ${ended.seconds.toFixed(1)} s: ${sums}.`
      : "";
  }

  /** Show smoothed rewards per second. */
  #showRates({ returns, counted }, dt) {
    const passed = counted - (this.counted ?? counted);
    if (passed > 0) {
      const calm = 1 - (1 - CALM) ** passed;
      returns.forEach((value, i) => {
        const rate = (value - this.former[i]) / (passed * dt);
        this.rates[i] = (1 - calm) * (this.rates[i] ?? rate) + calm * rate;
      });
    }
    if (passed !== 0 || !this.former) [this.counted, this.former] = [counted, [...returns]];
    this.cells.forEach((row, i) => (row[1].textContent = this.rates[i] === null ? "–" : amount(this.rates[i])));
  }

  #tabulate(number, names) {
    this.number = number;
    this.rates = names.map(() => null);
    this.counted = this.former = undefined;
    const titles = number === 1 ? ["return", "per second"] : [...Array(number).keys()].map((i) => `robot ${i + 1}`);
    const head = titles.map((textContent, i) => {
      const className = number > 1 ? "dot" : "";
      return html("th", { textContent, className, style: `--color: ${robotColor(i)}` });
    });
    this.cells = names.map(() => titles.map(() => html("td")));
    const rows = names.map((textContent, i) => {
      const title = html("th", { textContent, className: "objective", style: `--color: ${colorOf(i)}` });
      return html("tr", {}, title, ...this.cells[i]);
    });
    $("episode").replaceChildren(html("tr", {}, html("td"), ...head), ...rows);
  }
}

/** Format a number with about four digits. */
function amount(value) {
  const size = Math.abs(value);
  if (size >= 1e5) return short(value);
  return value.toFixed(size >= 100 ? 0 : size >= 10 ? 1 : 2);
}
