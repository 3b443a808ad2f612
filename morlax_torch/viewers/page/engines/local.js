// Moves robots in this browser: the page needs no server. See `Remote` for the other engine.

import { MOST } from "../tradeoffs.js";
import { keeping, valuesOf } from "../values.js";
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
    this.training = []; // evaluations whose fronts a server's run has kept, the newest last
    this.served = false; // nothing can be written here
    this.failure = this.saving = null;
    this.choosing = { levels: {}, maximized: 0, searching: false, found: null, reason: "" };
    this.scene = {}; // another object whenever other robots are to be drawn
    this.listener = { step() {}, tell() {} };
    this.due = 0;
    this.resets = false;
    this.left = []; // robots whose memory to free between two steps
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

  /** Set one number of the command; it is clamped to the task's limits. */
  tell(index, value) {
    const [low, high] = Object.values(this.about.command.limits)[index];
    for (const robot of this.robots) robot.command[index] = Math.min(Math.max(value, low), high);
  }

  nudge(index, change) {
    this.tell(index, this.command[index] + change);
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
    const kick = name === "push" && this.steered.kick(); // the same of all, so that twins stay in step
    if (kick) for (const robot of this.robots) robot.push(kick);
    if (name === "reset") this.resets = true;
    if (name === "free") this.#choose({}, this.choosing.maximized);
    if (name === "add" && this.robots.length < MOST) this.#show([...this.robots, this.steered.twin()]);
    if (name === "remove" && this.robots.length > 1) {
      this.left.push(this.steered);
      this.#show(this.robots.toSpliced(this.selected, 1));
    }
  }

  /** Require a return or a measured quantity; null: any. */
  require(index, level) {
    const { [index]: _, ...others } = this.choosing.levels;
    const levels = level === null ? others : { ...others, [index]: level };
    const free = this.about.objectives.findIndex((_, i) => !(i in levels));
    const { maximized } = this.choosing;
    this.#choose(levels, maximized in levels && free >= 0 ? free : maximized);
  }

  maximize(index) {
    this.#choose(this.choosing.levels, index);
  }

  /** Take the steps that are due after `elapsed` seconds; returns the share of the next one. */
  async advance(elapsed) {
    for (const { data } of this.left.splice(0)) data.delete();
    const { dt } = this.about;
    if (!this.paused) this.due += Math.min(elapsed, MOST_DELAY) * this.pace;
    if (this.resets) {
      this.resets = false;
      const start = Math.floor(Math.random() * this.about.starts.length); // twins begin alike
      for (const robot of this.robots) robot.reset(start);
      this.listener.step();
    }
    const begin = performance.now();
    while (this.due >= dt && performance.now() - begin < 1000 * MOST_DELAY) {
      this.due -= dt;
      const { robots } = this;
      for (const robot of robots) {
        if (robot.over) robot.restart();
        await robot.step();
        if (robot.over) this.listener.tell(OVER[robot.over]);
      }
      if (robots === this.robots) this.listener.step();
    }
    this.due = Math.min(this.due, dt);
    return this.due / dt;
  }

  /** Free the memory outside JavaScript, between two steps. */
  async release() {
    for (const { data } of [...this.left, ...this.robots]) data.delete();
    await Promise.all(Object.values(this.steered.graphs).map(({ session }) => session.release()));
    this.model.delete();
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
    this.choosing = { levels, maximized, searching: false, found: null, reason: "" };
    if (!Object.keys(levels).length) return;
    const kept = keeping(this.about, levels);
    if (!kept.length) {
      this.choosing.reason = "no evaluated policy keeps all of this";
      return;
    }
    const { front } = this.about;
    const all = valuesOf(this.about);
    const { values } = all.find(({ index }) => index === maximized);
    const best = kept.reduce((a, b) => (values[b] > values[a] ? b : a));
    const reached = (isPhysical) => {
      const those = all.filter(({ physical }) => physical === isPhysical);
      return Object.fromEntries(those.map(({ key, values }) => [key, values[best]]));
    };
    const [tradeoff, falls] = [front.tradeoffs[best], front.falls[best]];
    const cost = Math.max(...values) - values[best];
    this.choosing.found = { tradeoff, returns: reached(false), quantities: reached(true), cost, falls, simulated: 0 };
    this.steer(tradeoff);
  }
}
