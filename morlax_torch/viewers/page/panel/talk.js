// For talks: the robot alone on the whole screen, and bookmarks as stops with captions.

import { $, html } from "../pictures.js";

const WAYS = { ArrowRight: 1, PageDown: 1, ArrowLeft: -1, PageUp: -1 }; // also of a presenter

export class Talk {
  /** @param engine returns the present engine. */
  constructor(engine) {
    this.engine = engine;
    this.stop = null; // index of a bookmark; null: no talk
    document.addEventListener("fullscreenchange", () => document.fullscreenElement || this.#leave());
  }

  /** Offer a talk where there are bookmarks. */
  show() {
    $("talk").hidden = this.#stops().length === 0;
  }

  start() {
    document.body.classList.add("talk");
    document.activeElement?.blur(); // keys are for the talk now
    document.documentElement.requestFullscreen?.().catch(() => {}); // embedded pages may not
    this.#go(0);
  }

  /** Follow a key; returns whether it means anything. */
  press(key) {
    if (this.stop === null || !(key in WAYS || key === "Escape")) return false;
    if (key === "Escape") this.#leave();
    else this.#go(this.stop + WAYS[key]);
    return true;
  }

  #stops() {
    return Object.entries(this.engine()?.bookmarks ?? {});
  }

  #go(stop) {
    const stops = this.#stops();
    this.stop = Math.min(Math.max(stop, 0), stops.length - 1);
    const [name, weights] = stops[this.stop];
    this.engine().steer(weights);
    const { titles } = this.engine().about;
    const parts = titles.map((title, i) => `${title} ${Math.round(100 * weights[i])} %`);
    $("caption").replaceChildren(name, html("small", { textContent: parts.join(", ") }));
  }

  #leave() {
    if (this.stop === null) return;
    this.stop = null;
    document.body.classList.remove("talk");
    $("caption").replaceChildren();
    if (document.fullscreenElement) document.exitFullscreen();
  }
}
