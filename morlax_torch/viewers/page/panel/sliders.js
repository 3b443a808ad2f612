// Rows of sliders with a name, which can be a button, and a value.

import { html } from "../pictures.js";

export class Sliders {
  /** `move` is called with index and value while a visitor drags, `done` when he or she lets go. */
  constructor(place, rows, move, done = () => {}) {
    this.rows = rows;
    this.inputs = rows.map(({ name, limits: [min, max] }, index) => {
      const input = html("input", { type: "range", min, max, step: (max - min) / 200, ariaLabel: name });
      input.addEventListener("input", () => move(index, Number(input.value)));
      input.addEventListener("change", done);
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
      if (!this.inputs[i].matches(":active")) this.inputs[i].value = value;
      const { limits: [min, max], format } = this.rows[i];
      this.outputs[i].textContent = this.inputs[i].ariaValueText = format(value);
      this.elements[i].style.setProperty("--share", (value - min) / (max - min));
    });
  }
}
