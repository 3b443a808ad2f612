// Rows of sliders with a name, which can be a button, and a value.

import { html } from "../pictures.js";

export class Sliders {
  /** `move` and `done` are called with index and value while a visitor drags, and when he or she lets go. */
  constructor(place, rows, move, done = () => {}) {
    this.rows = rows;
    this.inputs = rows.map(({ name, limits: [min, max] }, index) => {
      const input = html("input", { type: "range", min, max, step: (max - min) / 200, ariaLabel: name });
      input.addEventListener("input", () => {
        this.#tell(index, input.valueAsNumber);
        move(index, input.valueAsNumber);
      });
      input.addEventListener("change", () => done(index, input.valueAsNumber));
      return input;
    });
    this.outputs = rows.map(() => html("output", { ariaHidden: true })); // inputs say it
    this.elements = rows.map(({ name, color, title = "", act }, index) => {
      const look = { className: "name dot", textContent: name, title };
      const head = html(act ? "button" : "span", act ? { ...look, type: "button", onclick: act } : look);
      const row = html("div", { className: "slider" }, head, this.inputs[index], this.outputs[index]);
      row.style.setProperty("--color", color);
      return row;
    });
    place.replaceChildren(...this.elements);
  }

  /** Show the values of all sliders; one that a visitor holds stays under the hand. */
  show(values) {
    values.forEach((value, i) => {
      if (this.inputs[i].matches(":active")) return;
      this.inputs[i].value = value;
      this.#tell(i, value);
    });
  }

  #tell(index, value) {
    const { limits: [min, max], format } = this.rows[index];
    this.outputs[index].textContent = this.inputs[index].ariaValueText = format(value);
    this.elements[index].style.setProperty("--share", (value - min) / (max - min));
  }
}
