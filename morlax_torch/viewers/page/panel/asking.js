// "A or B?": the visitor compares two robots, and sees what the answers tell.

import { $, chip, isNews, short } from "../pictures.js";
import { robotColor } from "../tradeoffs.js";
import { inUnit, named, present, valuesOf } from "../values.js";

const SIDES = ["A", "B"];

export class AskingPanel {
  constructor(engine) {
    this.engine = engine;
    // the second click of a double one would answer a question that nobody has seen
    const answer = (i) => ({ detail }) => detail < 2 && engine.answer(i);
    const answers = SIDES.map((side, i) => chip(side, "", answer(i), robotColor(i)));
    $("answers").replaceChildren(...answers, chip("skip", "", () => engine.press("skip")));
  }

  show() {
    const { asking } = this.engine;
    if (!isNews(this, asking, present())) return;
    $("asking-section").hidden = !asking;
    document.body.classList.toggle("asking", Boolean(asking));
    if (!asking) return;
    $("question").textContent = `Which robot do you like better? Answers so far: ${asking.answers}`;
    $("told").textContent = this.#told(asking.told);
    $("evidence").textContent = this.#evidence(asking);
  }

  /** Say what A and B of the question before earn. */
  #told(told) {
    const { about } = this.engine;
    if (!told) return "";
    const lines = told.policies.map((policy, side) => {
      const parts = valuesOf(about).map((value) => {
        return `${named(value)} ${short(inUnit(value, value.values[policy], about))}`;
      });
      return `${SIDES[side]}: ${parts.join(", ")}`;
    });
    return `You preferred ${SIDES[told.preferred]}. ${lines.join("; ")}.`;
  }

  /** Say which policy the visitor seems to like, and how sure that is. */
  #evidence({ answers, best_tradeoff: weights, confidence, left }) {
    if (!answers) return "";
    const parts = this.engine.about.titles.map((name, i) => `${name} ${weights[i].toFixed(2)}`);
    const rest = left ? `about ${left} more question${left > 1 ? "s" : ""}` : "that is enough";
    return `You seem to like ${parts.join(", ")} (${Math.round(100 * confidence)} % sure; ${rest}).`;
  }
}
