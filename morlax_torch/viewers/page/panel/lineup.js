// Several robots to compare: which one the sliders steer, and their names.

import { $, chip, isNews, renew } from "../pictures.js";
import { MOST, robotColor, summary } from "../tradeoffs.js";

export class LineupPanel {
  constructor(engine) {
    this.engine = engine;
  }

  show() {
    const { robots, selected, asking } = this.engine;
    $("robots").hidden = Boolean(asking);
    if (!isNews(this, robots.length, selected)) return;
    renew($("robots"), this.#buttons(robots.length, selected));
  }

  #buttons(number, selected) {
    const { engine } = this;
    const choices = number < 2 ? [] : Array.from({ length: number }, (_, i) => {
      const title = `Steer this robot (${i + 1})`;
      const choice = chip(`robot ${i + 1}`, title, () => engine.select(i), robotColor(i));
      choice.setAttribute("aria-pressed", i === selected);
      choice.dataset.key = i + 1;
      return choice;
    });
    const add = (text, title, name) => choices.push(chip(text, title, () => engine.press(name)));
    if (number < MOST) add("add a robot", "Compare it with another trade-off", "add");
    if (number > 1) add("remove", "Remove the chosen robot", "remove");
    if (engine.can.ask) add("A or B?", "Find your trade-off by comparing robots", "find");
    return choices;
  }
}

/** Show the names at the heads of several robots. */
export function showNames({ names, robots, selected, about }) {
  [...$("names").children].forEach((label, i) => {
    const text = names?.[i] ?? `${i + 1}: ${summary(robots[i].tradeoff, about.titles)}`;
    if (label.textContent !== text) label.textContent = text;
    label.classList.toggle("chosen", !names && i === selected);
  });
}
