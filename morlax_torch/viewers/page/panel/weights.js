// Trade-offs: m numbers, not negative, that sum to one.

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

/** Format a trade-off for `parsed`. */
export const shown = (weights) => weights.map((w) => Number(w.toFixed(3))).join(",");
