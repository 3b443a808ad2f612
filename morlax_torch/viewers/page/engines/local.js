// Moves robots in this browser: the page needs no server. See `Remote` for the other engine.

import { MOST } from "../colors.js";
import { Simulation } from "./simulation.js";

const MOST_DELAY = 0.1; // s to catch up with; the rest of a longer delay is dropped
const OVER = { fell: "The episode ended: new start", time: "Time is up: new start" };

export class Local {
  /** Load the robot of a folder that `pack --web` wrote. */
  static async load(folder) {
    return new Local(await Simulation.load(folder));
  }

  constructor(simulation) {
    const { model, about } = simulation;
    Object.assign(this, { model, about, robots: [simulation], selected: 0 });
    Object.assign(this, { paused: false, pace: 1, names: null, asking: null });
    this.bookmarks = about.bookmarks; // trade-offs by name
    this.keeps = false; // new bookmarks
    this.can = { ask: false, contacts: false, open: false };
    this.failure = null;
    this.choosing = { levels: {}, maximized: 0, searching: false, found: null, reason: "" };
    this.scene = {}; // another object whenever other robots are to be drawn
    this.listener = { step() {}, tell() {} };
    this.due = 0;
    this.resets = false;
    this.left = []; // robots to release between two steps
  }

  get steered() {
    return this.robots[this.selected];
  }

  get command() {
    return this.steered.command;
  }

  steer(weights) {
    this.steered.tradeoff = weights;
  }

  tell(index, value) {
    for (const robot of this.robots) robot.command[index] = value;
  }

  pause(on) {
    this.paused = on;
  }

  setPace(pace) {
    this.pace = pace;
  }

  select(index) {
    this.selected = index;
  }

  press(name) {
    if (name === "push") for (const robot of this.robots) robot.push();
    if (name === "reset") this.resets = true;
    if (name === "free") this.#choose({}, this.choosing.maximized);
    if (name === "add" && this.robots.length < MOST) this.#show([...this.robots, this.steered.twin()]);
    if (name === "remove" && this.robots.length > 1) {
      this.left.push(this.steered);
      this.#show(this.robots.toSpliced(this.selected, 1));
    }
  }

  /** Require a return of an objective; null: any. */
  require(index, least) {
    const { [index]: _, ...others } = this.choosing.levels;
    this.#choose(least === null ? others : { ...others, [index]: least }, this.choosing.maximized);
  }

  maximize(index) {
    this.#choose(this.choosing.levels, index);
  }

  /** Take the steps that are due after `elapsed` seconds; returns the share of the next one. */
  async advance(elapsed) {
    for (const robot of this.left.splice(0)) await robot.release(this.robots.length === 0);
    const { dt } = this.about;
    if (!this.paused) this.due += Math.min(elapsed, MOST_DELAY) * this.pace;
    if (this.resets) this.#restart();
    const begin = performance.now();
    while (this.due >= dt && performance.now() - begin < 1000 * MOST_DELAY) {
      this.due -= dt;
      const { robots } = this;
      for (const robot of robots) await this.#step(robot);
      if (robots === this.robots) this.listener.step();
    }
    this.due = Math.min(this.due, dt);
    return this.due / dt;
  }

  /** Free the memory outside JavaScript, between two steps. */
  async release() {
    this.left.push(...this.robots.splice(0));
    await this.advance(0);
  }

  async #step(robot) {
    if (robot.over) robot.restart();
    await robot.step();
    if (robot.over) this.listener.tell(OVER[robot.over]);
  }

  #restart() {
    this.resets = false;
    for (const robot of this.robots) robot.reset();
    this.listener.step();
  }

  /** Show other robots, which all start anew. */
  #show(robots) {
    const more = robots.length > this.robots.length;
    this.robots = robots;
    this.selected = more ? robots.length - 1 : Math.min(this.selected, robots.length - 1);
    this.scene = {};
    if (more) this.resets = true;
  }

  /** Take the best of the evaluated policies that keep what is required. */
  #choose(levels, maximized) {
    const { returns, tradeoffs } = this.about.front;
    const required = Object.entries(levels);
    this.choosing = { levels, maximized, searching: false, found: null, reason: "" };
    if (!required.length) return;
    const kept = returns.filter((row) => required.every(([i, least]) => row[i] >= least));
    if (!kept.length) {
      this.choosing.reason = "no evaluated policy keeps all of this";
      return;
    }
    const best = kept.reduce((a, b) => (b[maximized] > a[maximized] ? b : a));
    const tradeoff = tradeoffs[returns.indexOf(best)];
    const named = (row) => Object.fromEntries(this.about.objectives.map((name, i) => [name, row[i]]));
    const free = Math.max(...returns.map((row) => row[maximized]));
    this.choosing.found = { tradeoff, returns: named(best), cost: free - best[maximized], simulated: 0 };
    this.steer(tradeoff);
  }
}
