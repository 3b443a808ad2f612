// A trade-off as text, the balance as a button, and bookmarks, which are named in place.

import { $, chip, html, isNews, renew } from "../pictures.js";
import { even, parsed, shown } from "../tradeoffs.js";

const TOLD = 1500; // ms that "copied" is shown
const CALM = 1000; // ms after a key until the field follows others again

export class TypedWeights {
  /** `choose` is called with a trade-off that a visitor types or presses. */
  constructor(engine, choose) {
    Object.assign(this, { engine, choose });
    const m = engine.about.objectives.length;
    $("balance").onclick = () => choose(even(m));
    $("typed").value = spaced(engine.steered.tradeoff); // another run may have more weights
    this.typed = -CALM; // ms, when the visitor last typed
    $("typed").oninput = () => {
      this.typed = performance.now();
      const weights = parsed($("typed").value, m);
      this.#judge(Boolean(weights));
      if (weights) choose(weights);
    };
    $("copy").onclick = () => this.#copy().catch(() => $("typed").select());
    $("keep").onclick = () => this.#name(null);
    $("naming").hidden = true;
    $("naming").onsubmit = (event) => {
      event.preventDefault();
      const name = $("bookmark-name").value.trim();
      if (!name || name === this.named) this.#close();
      else if (this.named === null) engine.bookmark(name);
      else engine.rename(this.named, name);
    };
    $("naming").onkeydown = ({ key }) => {
      if (key === "Escape") this.#close(); // an arrow that returns false would swallow all keys
    };
    $("unname").onclick = () => this.#close();
  }

  show() {
    const text = spaced(this.engine.steered.tradeoff);
    if (!this.#edits()) {
      this.#judge(true);
      if ($("typed").value !== text) $("typed").value = text;
    }
    const { served, bookmarks } = this.engine;
    const keeps = served && bookmarks !== null; // shipped policies have none
    $("keep").hidden = !keeps;
    if (!isNews(this, bookmarks)) return;
    const isStored = Object.hasOwn(bookmarks ?? {}, $("bookmark-name").value.trim());
    if (isStored && !$("naming").hidden) this.#close(); // a refused name stays, to be changed
    const marks = Object.entries(bookmarks ?? {}).map(([name, weights]) => {
      const mark = chip(`@${name}`, `Bookmark: ${spaced(weights)}`, () => this.choose(weights));
      if (!keeps) return mark;
      const change = (text, title, act) => Object.assign(chip(text, title, act), { ariaLabel: title });
      return html(
        "span",
        { className: "joined" },
        mark,
        change("✎", `Rename ${name}`, () => this.#name(name)),
        change("✕", `Delete ${name}`, () => this.engine.rename(name, "")),
      );
    });
    renew($("bookmarks"), marks);
  }

  /** Ask for the name of a new bookmark, or for another name of one. */
  #name(former) {
    this.named = former;
    $("naming").hidden = false;
    $("bookmark-name").value = former ?? "";
    $("bookmark-name").focus();
  }

  #close() {
    $("naming").hidden = true;
    $("keep").focus();
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
    const names = this.engine.about.titles;
    const right = `${names.length} weights, none negative, for ${names.join(", ")}: such as`;
    $("typed").setAttribute("aria-invalid", !valid);
    $("mistyped").textContent = valid ? "" : `Type ${right} ${spaced(even(names.length))}.`;
  }

  async #copy() {
    const text = ($("typed").value = spaced(this.engine.steered.tradeoff, 5));
    await navigator.clipboard.writeText(text);
    $("copy").textContent = "copied";
    setTimeout(() => ($("copy").textContent = "copy"), TOLD);
  }
}

const spaced = (weights, digits = 3) => shown(weights, digits).replaceAll(",", ", ");
