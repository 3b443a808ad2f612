// What policies earn and do, and its unit for the whole page: per second, or per episode.

import { colorOf } from "./tradeoffs.js";

let per = "second";

export const present = () => per;

export function setUnit(unit) {
  per = unit;
}

/** Return how many times the number of a whole episode one in the present unit is smaller. */
const divisor = ({ physical }, { front }) => (physical || per === "episode" ? 1 : front.seconds);

/** Return a number of a whole episode in the present unit. */
export const inUnit = (kind, number, about) => number / divisor(kind, about);

/** Return a number in the present unit as one of a whole episode. */
export const ofEpisode = (kind, number, about) => number * divisor(kind, about);

/** Return the name of a value with its unit. */
export const named = ({ physical, name }) => (physical ? name : `${name} per ${per}`);

/** Return the values of a front's policies: measured quantities, which come first, and returns. */
export function valuesOf({ objectives, titles, front }) {
  const returns = objectives.map((key, index) => {
    const values = front.returns.map((row) => row[index]);
    return { index, key, name: titles[index], lower: false, physical: false, values, color: colorOf(index) };
  });
  const measured = front.measured.map((quantity) => {
    return { ...quantity, key: quantity.name, physical: true, color: "var(--ink)" };
  });
  return [...measured, ...returns];
}

/** Return the indices of the front's policies that keep required levels, by index of the value. */
export function keeping(about, levels) {
  const required = valuesOf(about).filter(({ index }) => index in levels);
  const keeps = (policy) =>
    required.every(({ index, lower, values }) => {
      return lower ? values[policy] <= levels[index] : values[policy] >= levels[index];
    });
  return about.front.returns.map((_, policy) => policy).filter(keeps);
}
