// The unit of everything that policies earn, for the whole page: per second, or per episode.

let per = "second";

export const present = () => per;

export function choose(unit) {
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
