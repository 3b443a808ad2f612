// Several robots to compare: which one the sliders steer, and their names.

import { $, chip, isNews } from "../pictures.js";
import { MOST, robotColor } from "../tradeoffs.js";

const FEW = 6; // weights in all names together; more would overlap on a phone

export class LineupPanel {
  constructor(engine) {
    this.engine = engine;
  }

  show() {
    const { robots, selected, asking } = this.engine;
    $("robots-section").hidden = Boolean(asking);
    if (!isNews(this, robots.length, selected)) return;
    $("robots").replaceChildren(...this.#buttons(robots.length, selected));
  }

  #buttons(number, selected) {
    const { engine } = this;
    const choices = number < 2 ? [] : Array.from({ length: number }, (_, i) => {
      const choice = chip(`robot ${i + 1}`, "Steer this robot", () => engine.select(i), robotColor(i));
      choice.setAttribute("aria-pressed", i === selected);
      return choice;
    });
    const add = (text, title, name) => choices.push(chip(text, title, () => engine.press(name)));
    if (number < MOST) add("add a robot", "Compare it with another trade-off", "add");
    if (number > 1) add("remove", "Remove the chosen robot", "remove");
    if (engine.can.ask) add("A or B?", "Find your trade-off by comparing robots", "find");
    return choices;
  }
}

/** Show the names above several robots. */
export function showNames(engine) {
  const { names, robots, selected } = engine;
  [...$("names").children].forEach((label, i) => {
    const text = names?.[i] ?? `${i + 1}: ${brief(robots[i], engine)}`;
    if (label.textContent !== text) label.textContent = text;
    label.classList.toggle("chosen", !names && i === selected);
  });
}

/** Return a robot's trade-off; of many weights, only the greatest. */
function brief({ tradeoff }, { robots, about }) {
  if (tradeoff.length * robots.length <= FEW) return tradeoff.map((w) => w.toFixed(2)).join(", ");
  const top = tradeoff.indexOf(Math.max(...tradeoff));
  return `${about.objectives[top]} ${tradeoff[top].toFixed(2)}`;
}
