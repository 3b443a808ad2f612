// What each robot earns and does at the moment, smoothed.

import { colorOf } from "../tradeoffs.js";
import { present } from "../values.js";

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

  /** What a robot does and earns, by its number, in the present unit; returns have an index. */
  get numbers() {
    const returns = this.engine.about.titles.map((name, index) => {
      const now = (i) => (present() === "second" ? this.robots[i]?.rates?.[index] : this.engine.robots[i].returns[index]);
      return { name, index, color: colorOf(index), now };
    });
    const ink = "var(--ink)";
    return [
      { name: "speed (m/s)", color: ink, now: (i) => this.robots[i]?.speed },
      { name: "mechanical power (W)", color: ink, now: (i) => this.robots[i]?.power },
      ...returns,
    ];
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
