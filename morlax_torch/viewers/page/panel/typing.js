// A trade-off as text, the corners and the balance as buttons, and bookmarks.

import { colorOf } from "../colors.js";
import { html } from "../pictures.js";
import { even, parsed, shown } from "./weights.js";

const $ = (id) => document.getElementById(id);
const TOLD = 1500; // ms that "copied" is shown

export class TypedWeights {
  /** @param choose called with a trade-off that a visitor types or presses. */
  constructor(engine, choose) {
    Object.assign(this, { engine, choose });
    const m = engine.about.objectives.length;
    const corners = engine.about.objectives.map((name, index) => {
      const weights = even(m).map((_, i) => (i === index ? 1 : 0));
      return this.#chip(name, `only ${name}`, weights, colorOf(index));
    });
    $("corners").replaceChildren(...corners, this.#chip("balance", "all objectives equally", even(m)));
    $("typed").oninput = () => {
      const weights = parsed($("typed").value, m);
      if (weights) choose(weights);
    };
    $("typed").onblur = () => (this.text = null);
    $("copy").onclick = () => copy().catch(() => $("typed").select());
    $("keep").title = "Keep this trade-off as a bookmark of the run";
    $("keep").onclick = () => {
      const name = prompt("Name of the bookmark (then --tradeoff @NAME in every command)");
      if (name) engine.keep(name);
    };
  }

  show() {
    const text = shown(this.engine.steered.tradeoff).replaceAll(",", ", ");
    if (text !== this.text && document.activeElement !== $("typed")) $("typed").value = this.text = text;
    $("keep").hidden = !this.engine.keeps;
    const kept = JSON.stringify(this.engine.bookmarks ?? {});
    if (kept === this.kept) return;
    this.kept = kept;
    const marks = Object.entries(this.engine.bookmarks ?? {});
    $("bookmarks").replaceChildren(...marks.map(([name, w]) => this.#chip(`@${name}`, "bookmark", w)));
  }

  #chip(text, title, weights, color) {
    const chip = html("button", { type: "button", className: "chip", textContent: text, title });
    if (color) chip.style.setProperty("--color", color);
    chip.classList.toggle("dot", Boolean(color));
    chip.addEventListener("click", () => this.choose(weights));
    return chip;
  }
}

async function copy() {
  await navigator.clipboard.writeText($("typed").value);
  $("copy").textContent = "copied";
  setTimeout(() => ($("copy").textContent = "copy"), TOLD);
}
