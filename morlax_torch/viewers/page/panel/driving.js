// Commands by keys and by a gamepad.

const NOTCH = 0.1; // share of a range that a key changes a number of the command by
const KEYS = { w: [0, 1], s: [0, -1], a: [1, 1], d: [1, -1], q: [2, 1], e: [2, -1] }; // number, direction
const STOP = "x";
const STICKS = [1, 0, 2]; // axes of a gamepad for each number: forward, to the left, turn
const DEAD = 0.1; // of a stick's way, where it counts as released

/** Follow a key; returns whether it means anything. */
export function press(engine, key) {
  const [index, way] = KEYS[key.toLowerCase()] ?? [];
  const ranges = limits(engine);
  if (key.toLowerCase() === STOP) ranges.forEach((_, i) => engine.tell(i, 0));
  else if (!ranges[index]) return false;
  else engine.nudge(index, way * NOTCH * (ranges[index][1] - ranges[index][0]));
  return ranges.length > 0;
}

const felt = []; // the sticks' former places

/** Follow the sticks of a gamepad, if there is one. */
export function drive(engine) {
  const pad = navigator.getGamepads?.().find(Boolean);
  if (!pad) return;
  limits(engine).forEach(([low, high], i) => {
    const way = -(pad.axes[STICKS[i]] ?? 0); // up and left are negative
    const place = Math.abs(way) < DEAD ? 0 : way;
    if (Math.abs(place - (felt[i] ?? 0)) < 0.02) return;
    felt[i] = place;
    engine.tell(i, place > 0 ? place * high : -place * low);
  });
}

const limits = ({ about }) => Object.values(about.command?.limits ?? {});
