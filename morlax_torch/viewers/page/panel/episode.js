// What the robots do now, in the present unit, and how the former episode ended.

import { $, amount, html, isNews } from "../pictures.js";
import { nearest, robotColor } from "../tradeoffs.js";
import { inUnit, present, valuesOf } from "../values.js";

export class Episode {
  constructor(engine, live) {
    Object.assign(this, { engine, live });
    const { terms } = engine.about;
    $("terms-section").hidden = !terms?.length;
    this.termCells = (terms ?? []).map(() => html("td"));
    const rows = this.termCells.map((cell, i) => html("tr", {}, html("th", { textContent: terms[i] }), cell));
    $("terms").replaceChildren(...rows);
  }

  show() {
    const { robots, about, selected, steered } = this.engine;
    const form = `${robots.length} ${present()} ${about.front?.fingerprint}`;
    if (form !== this.form) this.#tabulate(robots.length, about);
    this.form = form;
    for (const { cells, now } of this.rows) {
      if (now) robots.forEach((_, i) => (cells[i].textContent = amount(now(i))));
    }
    if (robots.length === 1 && about.front && isNews(this, form, steered.tradeoff)) {
      const policy = nearest(about.front.tradeoffs, steered.tradeoff);
      for (const { cells, value } of this.rows) {
        if (value) cells[1].textContent = amount(inUnit(value, value.values[policy], about));
      }
    }
    this.termCells.forEach((cell, i) => (cell.textContent = amount(steered.terms?.[i])));
    const { ended } = robots[selected];
    const sums = about.titles.map((name, i) => `${name} ${amount(ended?.returns[i] ?? 0)}`).join(", ");
    $("ended").textContent = ended
      ? `The last episode ${ended.fell ? "failed" : "ended"} after ${ended.seconds.toFixed(1)} s, with returns: ${sums}.`
      : "";
  }

  /** Return rows with a name, what a robot does now, and the value of evaluated policies. */
  #values(about) {
    const { numbers } = this.live;
    if (!about.front) return numbers;
    const values = valuesOf(about);
    for (const row of numbers) {
      row.value = values.find(({ key, index }) => key === row.name || index === row.index);
    }
    const [speed, ...others] = numbers;
    const measured = values.filter(({ physical, key }) => physical && key !== speed.name);
    return [speed, ...measured.map((value) => ({ name: value.key, value, color: "var(--ink)" })), ...others];
  }

  #tabulate(number, about) {
    const all = this.#values(about).filter(({ now }) => number === 1 || now);
    const one = [present() === "second" ? "now" : "so far", ...(about.front ? ["evaluated"] : [])];
    const titles = number === 1 ? one : [...Array(number).keys()].map((i) => `${i + 1}`);
    const head = titles.map((textContent, i) => {
      const className = number > 1 ? "dot" : "";
      return html("th", { textContent, className, style: `--color: ${robotColor(i)}` });
    });
    this.rows = all.map((row) => ({ ...row, cells: titles.map(() => html("td", { textContent: "–" })) }));
    const rows = this.rows.map(({ name, color, cells }) => {
      const title = html("th", { textContent: name, className: "dot", style: `--color: ${color}` });
      return html("tr", {}, title, ...cells);
    });
    const corner = html("th", { textContent: `returns per ${present()}` });
    $("episode").replaceChildren(html("thead", {}, html("tr", {}, corner, ...head)), html("tbody", {}, ...rows));
  }
}
