// Rows of sliders with a name, which can be a button, and a value.

import { html } from "../pictures.js";

export class Sliders {
  /** `move` and `done` are called with index and value while a visitor drags, and when he or she lets go. */
  constructor(place, rows, move, done = () => {}) {
    this.rows = rows.map((row, index) => {
      const { name, limits: [min, max], color, title = "", act } = row;
      const look = { className: "name dot", textContent: name, title };
      const head = html(act ? "button" : "span", act ? { ...look, type: "button", onclick: act } : look);
      const input = html("input", { type: "range", min, max, step: (max - min) / 200, ariaLabel: name });
      const output = html("output", { ariaHidden: true }); // the input says it
      const element = html("div", { className: "slider", style: `--color: ${color}` }, head, input, output);
      const shown = { ...row, input, output, element };
      input.addEventListener("input", () => {
        tell(shown, input.valueAsNumber);
        move(index, input.valueAsNumber);
      });
      input.addEventListener("change", () => done(index, input.valueAsNumber));
      return shown;
    });
    place.replaceChildren(...this.rows.map(({ element }) => element));
  }

  /** Show the values of all sliders; one that a visitor holds stays under the hand. */
  show(values) {
    values.forEach((value, i) => {
      const { input } = this.rows[i];
      if (input.matches(":active")) return;
      input.value = value;
      tell(this.rows[i], value);
    });
  }
}

function tell({ input, output, element, limits: [min, max], format }, value) {
  output.textContent = input.ariaValueText = format(value);
  element.style.setProperty("--share", (value - min) / (max - min));
}
