// Random numbers of the kinds that tasks draw.

/** Return a standard normal number. */
export function normal() {
  const radius = Math.sqrt(-2 * Math.log(1 - Math.random()));
  return radius * Math.cos(2 * Math.PI * Math.random());
}

const KINDS = {
  uniform: (low, high) => low + (high - low) * Math.random(),
  normal: (mean, deviation) => mean + deviation * normal(),
  integer: (low, high) => Math.floor(low + (high - low) * Math.random()),
};

/** Draw `size` numbers: "uniform" or "integer" in [low, high), or "normal". */
export function draw(kind, parameters, size) {
  return Array.from({ length: size }, () => KINDS[kind](...parameters));
}
