// Choose a trade-off by what its policy must reach: returns of an episode.

import { colorOf } from "../colors.js";
import { html, short } from "../pictures.js";
import { Sliders } from "./sliders.js";

const $ = (id) => document.getElementById(id);

export class ChoosingPanel {
  /** @param settled called when thresholds have changed. */
  constructor(engine, settled) {
    this.engine = engine;
    const { objectives, front } = engine.about;
    const options = objectives.map((name, i) => new Option(name, i));
    $("maximize").replaceChildren(...options);
    $("maximize").onchange = () => {
      engine.maximize(Number($("maximize").value));
      settled();
    };
    $("free").onclick = () => engine.press("free");
    this.lowest = objectives.map((_, i) => Math.min(...front.returns.map((row) => row[i])));
    const rows = objectives.map((name, i) => {
      const high = Math.max(...front.returns.map((row) => row[i]));
      const format = (value) => (value > this.lowest[i] ? `≥ ${short(value)}` : "any");
      return { name, label: `at least ${name}`, limits: [this.lowest[i], high], color: colorOf(i), format };
    });
    this.asked = {}; // shown while a visitor drags
    const move = (index, value) => {
      this.asked[index] = value;
      this.sliders.show(this.#values());
    };
    const done = () => {
      for (const [index, value] of Object.entries(this.asked)) {
        engine.require(Number(index), value > this.lowest[index] ? value : null);
      }
      this.asked = {};
      this.key = null;
      settled();
    };
    this.sliders = new Sliders(rows, move, done);
    $("levels").replaceChildren(...this.sliders.elements);
  }

  show() {
    const { choosing } = this.engine;
    const key = JSON.stringify(choosing);
    if (key === this.key || !choosing || Object.keys(this.asked).length) return;
    this.key = key;
    this.sliders.show(this.#values());
    $("maximize").value = choosing.maximized;
    $("free").hidden = !Object.keys(choosing.levels).length;
    $("found").textContent = this.#result(choosing);
    $("found").dataset.state = choosing.found ? "found" : choosing.reason ? "missed" : "";
  }

  #values() {
    const { levels } = this.engine.choosing;
    return this.lowest.map((low, i) => this.asked[i] ?? levels[i] ?? low);
  }

  #result({ searching, found, reason, maximized }) {
    if (searching) return "Simulating policies…";
    if (reason) return `${reason[0].toUpperCase()}${reason.slice(1).replace(/\.$/, "")}.`;
    if (!found) return "";
    const returns = Object.entries(found.returns).map(([name, value]) => `${name} ${short(value)}`);
    const how = found.simulated ? "Simulated" : "Evaluated";
    const name = this.engine.about.objectives[maximized];
    const cost = found.cost > 0 ? ` This costs ${short(found.cost)} of ${name}.` : "";
    return `${how} returns: ${returns.join(", ")}.${cost}`;
  }
}
