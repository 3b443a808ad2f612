// What each robot earns and does at the moment, smoothed.

import { present } from "./units.js";

const CALM = 0.05; // share of a new number in the smoothed one

export class Live {
  constructor(engine) {
    Object.assign(this, { engine, robots: [] });
  }

  show() {
    const { robots, about } = this.engine;
    if (robots.length !== this.robots.length) this.robots = robots.map(() => ({}));
    robots.forEach((robot, i) => follow(this.robots[i], robot, about.dt));
  }

  /** Return what a robot reaches in the present unit, if it goes on like this; null: unknown. */
  reach(robot, { index, key, physical }) {
    const { rates, speed } = this.robots[robot] ?? {};
    if (!rates) return null;
    if (physical) return key === "speed (m/s)" ? speed : null;
    return present() === "second" ? rates[index] : rates[index] * this.engine.about.front.seconds;
  }
}

/** Bring the smoothed numbers of a robot up to date. */
function follow(now, { counted, returns, velocity, power }, dt) {
  const passed = counted - (now.counted ?? counted);
  if (passed > 0) {
    const fresh = (1 - CALM) ** passed;
    const calm = (former, number) => (former === undefined ? number : fresh * former + (1 - fresh) * number);
    now.rates = returns.map((sum, k) => calm(now.rates?.[k], (sum - now.former[k]) / (passed * dt)));
    now.speed = calm(now.speed, Math.hypot(...velocity));
    now.power = calm(now.power, power);
  }
  if (passed !== 0 || !now.former) Object.assign(now, { counted, former: [...returns] });
}
