// Choose a trade-off by what its policy must reach: returns, or measured quantities.

import { $, isNews, percent, short } from "../pictures.js";
import { inUnit, named, present, valuesOf } from "../values.js";
import { Sliders } from "./sliders.js";

export class ChoosingPanel {
  /** @param settled called with the index of a value whose threshold has changed, or that is maximized. */
  constructor(engine, settled) {
    Object.assign(this, { engine, settled });
    this.numbers = valuesOf(engine.about);
    $("maximize").onchange = () => {
      engine.maximize(Number($("maximize").value));
      settled(Number($("maximize").value));
    };
    this.rows = this.numbers.map((number) => this.#rowOf(number));
    const done = (i, value) => this.require(this.numbers[i].index, isFree(this.rows[i], value) ? null : value);
    this.sliders = new Sliders($("levels"), this.rows, () => {}, done);
    this.sliders.rows.forEach(({ input }, i) => {
      input.value = this.rows[i].rest;
      this.rows[i].rest = Number(input.value); // the last step may lie before the right end
    });
  }

  /** Require a value, by its index; null: any. */
  require(index, level) {
    this.engine.require(index, level);
    $("choosing-section").open = true;
    this.facts = null;
    this.settled(index);
  }

  show() {
    const { choosing } = this.engine;
    if (!choosing || !isNews(this, choosing, present())) return;
    const { levels, maximized, searching, found, reason, progress } = choosing;
    this.sliders.show(this.numbers.map(({ index }, i) => levels[index] ?? this.rows[i].rest));
    const offered = this.numbers.filter(({ lower, index }) => !lower && (index === maximized || !(index in levels)));
    $("maximize").replaceChildren(...offered.map(({ name, index }) => new Option(name, index)));
    $("maximize").value = maximized;
    $("free").hidden = !Object.keys(levels).length;
    $("search").hidden = !searching;
    $("search-share").value = progress?.share ?? 0;
    $("search-round").textContent = progress?.round ? `simulating policies, round ${progress.round}` : "preparing…";
    $("found").textContent = searching ? "" : this.#result(choosing);
    $("found").dataset.state = reason || found?.falls ? "missed" : found ? "found" : "";
  }

  /** Say in one line what was found, its margins and its cost. */
  #result({ found, reason, levels, maximized }) {
    if (reason) return `${reason[0].toUpperCase()}${reason.slice(1).replace(/\.$/, "")}.`;
    if (!found) return "";
    const { about } = this.engine;
    const show = (number, value) => short(inUnit(number, value, about));
    const all = { ...found.returns, ...found.quantities };
    const parts = this.numbers.flatMap((number) => {
      const { index, key, lower } = number;
      if (index === maximized) return [`${named(number)} ${show(number, all[key])}`];
      if (!(index in levels)) return [];
      const spare = Math.abs(all[key] - levels[index]);
      return [`${named(number)} ${show(number, all[key])} (${show(number, spare)} ${lower ? "below" : "above"} the limit)`];
    });
    const most = this.numbers.find(({ index }) => index === maximized);
    const cost = found.cost > 0 ? `; costs ${show(most, found.cost)} of ${named(most)}` : "";
    const how = found.simulated ? `Best of ${found.simulated} simulated policies` : "Best evaluated policy";
    const falls = found.falls ? ` It falls in ${percent(found.falls)} of its episodes, which these values include; in these it keeps no requirement.` : "";
    return `${how}: ${parts.join(", ")}${cost}.${falls}`;
  }

  /** Return a slider; `rest` is the end at which it requires nothing. */
  #rowOf(number) {
    const { name, lower, values, color } = number;
    const limits = [Math.min(...values), Math.max(...values)];
    const row = { name: `at ${lower ? "most" : "least"} ${name}`, lower, limits, color };
    row.rest = limits[lower ? 1 : 0];
    row.format = (value) => {
      if (isFree(row, value)) return "any";
      return `${lower ? "≤" : "≥"} ${short(inUnit(number, value, this.engine.about))}`;
    };
    return row;
  }
}

const isFree = ({ lower, rest }, value) => (lower ? value >= rest : value <= rest);
