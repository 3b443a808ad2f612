// Choose a trade-off by what its policy must reach: returns of an episode, or measured quantities.

import { $, isNews, percent, short } from "../pictures.js";
import { colorOf, requirable } from "../tradeoffs.js";
import { Sliders } from "./sliders.js";

export class ChoosingPanel {
  /** @param settled called when thresholds have changed. */
  constructor(engine, settled) {
    this.engine = engine;
    this.numbers = requirable(engine.about);
    const rising = this.numbers.filter(({ lower }) => !lower);
    $("maximize").replaceChildren(...rising.map(({ name, index }) => new Option(name, index)));
    $("maximize").onchange = () => {
      engine.maximize(Number($("maximize").value));
      settled();
    };
    $("free").onclick = () => engine.press("free");
    const m = engine.about.objectives.length;
    const colors = this.numbers.map((_, i) => (i < m ? colorOf(i) : "var(--ink)"));
    this.rows = this.numbers.map((number, i) => rowOf(number, colors[i]));
    this.asked = {}; // shown while a visitor drags
    const move = (i, value) => {
      this.asked[i] = value;
      this.sliders.show(this.#values());
    };
    const done = () => {
      for (const [i, value] of Object.entries(this.asked)) {
        engine.require(this.numbers[i].index, isFree(this.rows[i], value) ? null : value);
      }
      this.asked = {};
      this.facts = null;
      settled();
    };
    this.sliders = new Sliders(this.rows, move, done);
    this.sliders.inputs.forEach((input, i) => {
      input.value = this.rows[i].rest;
      this.rows[i].rest = Number(input.value); // the last step may lie before the right end
    });
    $("levels").replaceChildren(...this.sliders.elements);
  }

  show() {
    const { choosing } = this.engine;
    if (!choosing || Object.keys(this.asked).length || !isNews(this, choosing)) return;
    this.sliders.show(this.#values());
    $("maximize").value = choosing.maximized;
    $("free").hidden = !Object.keys(choosing.levels).length;
    $("found").textContent = this.#result(choosing);
    const { found, reason } = choosing;
    $("found").dataset.state = reason || found?.falls ? "missed" : found ? "found" : "";
  }

  #values() {
    const { levels } = this.engine.choosing;
    return this.numbers.map(({ index }, i) => this.asked[i] ?? levels[index] ?? this.rows[i].rest);
  }

  #result({ searching, found, reason, levels, maximized }) {
    if (searching) return "Simulating policies…";
    if (reason) return `${reason[0].toUpperCase()}${reason.slice(1).replace(/\.$/, "")}.`;
    if (!found) return "";
    const listed = (values) => values.map(([name, value]) => `${name} ${short(value)}`).join(", ");
    const how = found.simulated ? "Simulated" : "Evaluated";
    const used = this.numbers.filter(({ index }) => index in levels || index === maximized);
    const quantities = used.filter(({ name }) => name in found.quantities);
    const measured = listed(quantities.map(({ name }) => [name, found.quantities[name]]));
    const { name } = this.numbers.find(({ index }) => index === maximized);
    return [
      `${how} returns: ${listed(Object.entries(found.returns))}.`,
      ...(measured ? [`Measured: ${measured}.`] : []),
      ...(found.cost > 0 ? [`This costs ${short(found.cost)} of ${name}.`] : []),
      ...(found.falls ? [`It falls in ${percent(found.falls)} of its episodes, which breaks every requirement.`] : []),
    ].join(" ");
  }
}

/** Return a slider; `rest` is the end at which it requires nothing. */
function rowOf({ name, lower, values }, color) {
  const limits = [Math.min(...values), Math.max(...values)];
  const row = { name: `at ${lower ? "most" : "least"} ${name}`, lower, limits, color };
  row.rest = limits[lower ? 1 : 0];
  row.format = (value) => (isFree(row, value) ? "any" : `${lower ? "≤" : "≥"} ${short(value)}`);
  return row;
}

const isFree = ({ lower, rest }, value) => (lower ? value >= rest : value <= rest);
