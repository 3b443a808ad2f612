// A trade-off as text, the corners and the balance as buttons, and bookmarks.

import { $, chip, isNews } from "../pictures.js";
import { colorOf, even, parsed, shown } from "../tradeoffs.js";

const TOLD = 1500; // ms that "copied" is shown
const CALM = 1000; // ms after a key until the field follows others again

export class TypedWeights {
  /** `choose` is called with a trade-off that a visitor types or presses. */
  constructor(engine, choose) {
    Object.assign(this, { engine, choose });
    const m = engine.about.objectives.length;
    const corners = engine.about.objectives.map((name, index) => {
      const weights = even(m).map((_, i) => (i === index ? 1 : 0));
      return chip(name, `only ${name}`, () => choose(weights), colorOf(index));
    });
    const balance = chip("balance", "all objectives equally", () => choose(even(m)));
    $("corners").replaceChildren(...corners, balance);
    $("typed").value = spaced(engine.steered.tradeoff); // another run may have more weights
    this.typed = -CALM; // ms, when the visitor last typed
    $("typed").oninput = () => {
      this.typed = performance.now();
      const weights = parsed($("typed").value, m);
      this.#judge(Boolean(weights));
      if (weights) choose(weights);
    };
    $("copy").onclick = () => this.#copy().catch(() => $("typed").select());
    $("keep").title = "Keep this trade-off as a bookmark of the run";
    $("keep").onclick = () => {
      const name = prompt("Name of the bookmark (then --tradeoff @NAME in every command)");
      if (name) engine.bookmark(name);
    };
  }

  show() {
    const text = spaced(this.engine.steered.tradeoff);
    if (!this.#edits()) {
      this.#judge(true);
      if ($("typed").value !== text) $("typed").value = text;
    }
    $("keep").hidden = !this.engine.keeps;
    if (!isNews(this, this.engine.bookmarks)) return;
    const marks = Object.entries(this.engine.bookmarks ?? {}).map(([name, weights]) => {
      return chip(`@${name}`, "bookmark", () => this.choose(weights));
    });
    $("bookmarks").replaceChildren(...marks);
  }

  /** Return whether the field has the visitor's own text: a trade-off in other words, or an unfinished one. */
  #edits() {
    if (document.activeElement !== $("typed")) return false;
    const { tradeoff } = this.engine.steered;
    const weights = parsed($("typed").value, tradeoff.length);
    return !weights || shown(weights) === shown(tradeoff) || performance.now() - this.typed < CALM;
  }

  /** Say what is right, unless the field has a trade-off. */
  #judge(valid) {
    const names = this.engine.about.objectives;
    const right = `${names.length} weights, none negative, for ${names.join(", ")}: such as`;
    $("typed").setAttribute("aria-invalid", !valid);
    $("mistyped").textContent = valid ? "" : `Type ${right} ${spaced(even(names.length))}.`;
  }

  async #copy() {
    const text = ($("typed").value = spaced(this.engine.steered.tradeoff));
    await navigator.clipboard.writeText(text);
    $("copy").textContent = "copied";
    setTimeout(() => ($("copy").textContent = "copy"), TOLD);
  }
}

const spaced = (weights) => shown(weights).replaceAll(",", ", ");
