// Colors of objectives, trade-offs and robots.

// Okabe and Ito: distinct to color-blind readers too.
const PALETTE = ["#0072b2", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#56b4e9"];
const ROBOTS = ["#7048e8", "#0b7285", "#c2255c", "#4a7a0a"];
export const MOST = ROBOTS.length; // robots on one stage

/** Return the color of an objective by its index. */
export const colorOf = (index) => PALETTE[index % PALETTE.length];

/** Return the color of a robot's ring, name and mark by its index. */
export const robotColor = (index) => ROBOTS[index];

/** Return the color of a trade-off: the objectives' colors, mixed by weight. */
export function mixed(weights) {
  const channel = (from) =>
    weights.reduce((sum, w, i) => sum + w * parseInt(colorOf(i).slice(from, from + 2), 16), 0);
  return `rgb(${[1, 3, 5].map((from) => Math.round(channel(from))).join(" ")})`;
}
