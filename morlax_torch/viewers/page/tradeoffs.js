// Trade-offs: m numbers, not negative, that sum to one; and their colors.

// Okabe and Ito: distinct to color-blind readers too.
const PALETTE = ["#0072b2", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#56b4e9"];
const ROBOTS = ["#7048e8", "#0b7285", "#c2255c", "#4a7a0a"];
export const MOST = ROBOTS.length; // robots on one stage

/** Return the color of an objective by its index. */
export const colorOf = (index) => PALETTE[index % PALETTE.length];

export const robotColor = (index) => ROBOTS[index];

/** Return the color of a trade-off: the objectives' colors, mixed by weight. */
export function mixed(weights) {
  const channel = (from) =>
    weights.reduce((sum, w, i) => sum + w * parseInt(colorOf(i).slice(from, from + 2), 16), 0);
  return `rgb(${[1, 3, 5].map((from) => Math.round(channel(from))).join(" ")})`;
}

/** Return the balanced trade-off of m objectives. */
export const even = (m) => Array(m).fill(1 / m);

/** Set one weight to `value` in [0, 1] and scale the others, so that all sum to one. */
export function moved(weights, index, value) {
  const rest = weights.reduce((sum, w, i) => (i === index ? sum : sum + w), 0);
  const share = (w) => (rest > 1e-9 ? w / rest : 1 / (weights.length - 1));
  return weights.map((w, i) => (i === index ? value : (1 - value) * share(w)));
}

/** Parse "0.7,0.3" as a trade-off of m objectives; null if it is none. */
export function parsed(text, m) {
  const parts = (text ?? "").trim().split(/[,;\s]+/);
  const numbers = parts.map((part) => (/^\.?\d/.test(part) ? Number(part) : NaN));
  const total = numbers.reduce((sum, x) => sum + x, 0);
  const valid = numbers.length === m && numbers.every((x) => x >= 0) && total > 0;
  return valid && Number.isFinite(total) ? numbers.map((x) => x / total) : null;
}

/** Format a trade-off for `parsed`; with five digits, policies that were chosen stay the same. */
export const shown = (weights, digits = 5) => weights.map((w) => Number(w.toFixed(digits))).join(",");

/** Say a trade-off in a few words: its largest weights. */
export function summary(weights, titles) {
  if (Math.max(...weights) - Math.min(...weights) < 0.005) return "balance";
  const order = weights.map((_, i) => i).sort((a, b) => weights[b] - weights[a]);
  const parts = order.filter((i) => weights[i] >= 0.005).map((i) => `${titles[i]} ${Math.round(100 * weights[i])} %`);
  return parts.length > 2 ? `${parts.slice(0, 2).join(", ")}, …` : parts.join(", ");
}

/** Return the squared distance of two points. */
export const distance = (a, b) => a.reduce((sum, x, i) => sum + (x - b[i]) ** 2, 0);

/** Return the index of the trade-off that is nearest to another one. */
export const nearest = (tradeoffs, wanted) => lowest(tradeoffs, (weights) => distance(weights, wanted));

/** Return the index of the item with the lowest score. */
export function lowest(items, score) {
  const scores = items.map(score);
  return scores.indexOf(Math.min(...scores));
}
