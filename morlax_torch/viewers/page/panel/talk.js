// For talks: the robot alone on the whole screen, and bookmarks as stops with captions.

import { $, html } from "../pictures.js";

const WAYS = { ArrowRight: 1, PageDown: 1, ArrowLeft: -1, PageUp: -1 }; // also of a presenter

let stop = null; // index of a bookmark; null: no talk

export function begin(engine) {
  document.body.classList.add("talk");
  document.activeElement?.blur(); // keys are for the talk now
  document.documentElement.requestFullscreen?.().catch(() => {}); // embedded pages may not
  go(engine, 0);
}

/** Follow a key; returns whether it means anything. */
export function follow(engine, key) {
  if (stop === null || !(key in WAYS || key === "Escape")) return false;
  if (key === "Escape") leave();
  else go(engine, stop + WAYS[key]);
  return true;
}

function go(engine, next) {
  const stops = Object.entries(engine.bookmarks ?? {});
  if (!stops.length) return leave(); // another tab has deleted the last
  stop = Math.min(Math.max(next, 0), stops.length - 1);
  const [name, weights] = stops[stop];
  engine.steer(weights);
  const parts = engine.about.titles.map((title, i) => `${title} ${Math.round(100 * weights[i])} %`);
  $("caption").replaceChildren(name, html("small", { textContent: parts.join(", ") }));
}

function leave() {
  if (stop === null) return;
  stop = null;
  document.body.classList.remove("talk");
  $("caption").replaceChildren();
  if (document.fullscreenElement) document.exitFullscreen();
}

document.addEventListener("fullscreenchange", () => document.fullscreenElement || leave());
