// Several robots to compare: which one the sliders steer.

import { $, chip, isNews, renew } from "../pictures.js";
import { MOST, robotColor } from "../tradeoffs.js";

export class LineupPanel {
  constructor(engine) {
    this.engine = engine;
  }

  show() {
    const { engine } = this;
    const { robots, selected } = engine;
    if (!isNews(this, robots.length, selected)) return;
    const buttons = (robots.length > 1 ? robots : []).map((_, i) => {
      const title = `Steer this robot (${i + 1})`;
      const choice = chip(`robot ${i + 1}`, title, () => engine.select(i), robotColor(i));
      choice.setAttribute("aria-pressed", i === selected);
      choice.dataset.key = i + 1;
      return choice;
    });
    const add = (text, title, name) => buttons.push(chip(text, title, () => engine.press(name)));
    if (robots.length < MOST) add("add a robot", "Compare it with another trade-off", "add");
    if (robots.length > 1) add("remove", "Remove the chosen robot", "remove");
    if (engine.served) add("A or B?", "Find your trade-off by comparing robots", "find");
    renew($("robots"), buttons);
  }
}
