// Several robots to compare: which one the sliders steer, and their names.

import { MOST, robotColor } from "../colors.js";
import { html } from "../pictures.js";

const $ = (id) => document.getElementById(id);
const FEW = 6; // weights in all names together; more would overlap on a phone

export class LineupPanel {
  constructor(engine) {
    this.engine = engine;
    this.key = null;
  }

  show() {
    const { robots, selected, asking } = this.engine;
    $("robots-section").hidden = Boolean(asking);
    const key = JSON.stringify([robots.length, selected, Boolean(asking)]);
    if (key === this.key) return;
    this.key = key;
    $("robots").replaceChildren(...this.#buttons(robots.length, selected));
  }

  #buttons(number, selected) {
    const { engine } = this;
    const button = (text, title, act, className = "chip") => {
      const made = html("button", { type: "button", textContent: text, title, className });
      made.addEventListener("click", act);
      return made;
    };
    const choices = number < 2 ? [] : Array.from({ length: number }, (_, i) => {
      const choice = button(`robot ${i + 1}`, "Steer this robot", () => engine.select(i), "chip dot");
      choice.style.setProperty("--color", robotColor(i));
      choice.setAttribute("aria-pressed", i === selected);
      return choice;
    });
    if (number < MOST) choices.push(button("add a robot", "Compare it with another trade-off", () => engine.press("add")));
    if (number > 1) choices.push(button("remove", "Remove the chosen robot", () => engine.press("remove")));
    if (engine.can.ask) choices.push(button("A or B?", "Find your trade-off by comparing robots", () => engine.press("find")));
    return choices;
  }
}

/** The names above several robots. */
export class RobotNames {
  constructor(engine) {
    this.engine = engine;
  }

  show() {
    const { names, robots, selected } = this.engine;
    [...$("names").children].forEach((label, i) => {
      const text = names?.[i] ?? `${i + 1}: ${brief(robots[i], this.engine)}`;
      if (label.textContent !== text) label.textContent = text;
      label.classList.toggle("chosen", !names && i === selected);
    });
  }
}

/** Return a robot's trade-off; of many weights, only the greatest. */
function brief({ tradeoff }, { robots, about }) {
  if (tradeoff.length * robots.length <= FEW) return tradeoff.map((w) => w.toFixed(2)).join(", ");
  const top = tradeoff.indexOf(Math.max(...tradeoff));
  return `${about.objectives[top]} ${tradeoff[top].toFixed(2)}`;
}
