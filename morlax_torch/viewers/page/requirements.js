// Numbers of the front's policies that a visitor can require.

/** Return returns by objective, then measured quantities: index, name, `lower` (is better), values. */
export function requirable({ objectives, front }) {
  const returns = objectives.map((name, index) => {
    return { index, name, lower: false, values: front.returns.map((row) => row[index]) };
  });
  return [...returns, ...front.measured];
}

/** Return the indices of the front's policies that keep required levels, by index of the number. */
export function keeping(about, levels) {
  const limits = requirable(about).filter(({ index }) => index in levels);
  const keeps = (policy) =>
    limits.every(({ index, lower, values }) => {
      return lower ? values[policy] <= levels[index] : values[policy] >= levels[index];
    });
  return about.front.returns.map((_, policy) => policy).filter(keeps);
}
