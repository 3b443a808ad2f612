// Robots that a server moves: `morlax explore`. See `Local` for the other engine.

import { Problem, arraysOf } from "../files.js";

const [MODEL, FRAME] = [0, 1]; // first number of a message that is not JSON
const AGAIN = 1000; // ms until a lost connection is tried again

export class Remote {
  /** Connect to the server of this page, and wait for its robots. */
  static connect(listener) {
    return new Promise((resolve, reject) => {
      const remote = new Remote({ ...listener, ready: () => resolve(remote), refused: reject });
    });
  }

  static {
    // what the server tells; null where it tells nothing
    const told = ["paused", "pace", "failure", "command", "choosing", "asking", "bookmarks", "saving", "training"];
    for (const name of told) {
      Object.defineProperty(Remote.prototype, name, { get() { return this.state[name] ?? null; } });
    }
    // what the server is asked for: only its answer shows it. `nudge` changes the command by a
    // difference, since a sum formed here would miss keys that are not answered yet
    const acts = {
      nudge: ["index", "change"],
      select: ["robot"],
      press: ["name"],
      require: ["index", "level"],
      maximize: ["index"],
      answer: ["preferred"],
      bookmark: ["name"],
      rename: ["name", "new"],
    };
    for (const [act, names] of Object.entries(acts)) {
      Remote.prototype[act] = function (...values) {
        this.#send({ act, ...Object.fromEntries(names.map((name, i) => [name, values[i]])) });
      };
    }
  }

  constructor(listener) {
    Object.assign(this, { listener, robots: [], state: {}, scene: {} });
    this.poses = []; // of each robot: steps, places, turns, contacts, ghost
    this.next = null; // about, model, state and poses of a run whose parts are still coming
    this.arrived = 0; // ms, when they came
    this.interval = 25; // ms between frames
    this.served = true; // which can do more than a browser
    this.ready = false;
    this.#connect();
  }

  get names() {
    return this.asking ? ["A", "B"] : null;
  }

  get selected() {
    // the state may have come before the robot's pose
    return this.asking ? 0 : Math.min(this.state.selected ?? 0, this.robots.length - 1);
  }

  get steered() {
    return this.robots[this.selected];
  }

  steer(weights) {
    this.steered.tradeoff = weights; // shown at once; the server's answer follows
    this.#send({ act: "steer", weights });
  }

  tell(index, value) {
    this.command[index] = value;
    this.#send({ act: "tell", index, value });
  }

  /** Set one design parameter of all robots' body. */
  reshape(index, value) {
    this.state.design[index] = value;
    this.state.measured = false;
    this.#send({ act: "reshape", index, value });
  }

  pause(on) {
    this.state.paused = on;
    this.#send({ act: "pause", on });
  }

  setPace(value) {
    this.state.pace = value;
    this.#send({ act: "pace", value });
  }

  open(run, checkpoint = null) {
    this.listener.tell(`Opening ${run}…`);
    this.#send({ act: "open", run, checkpoint });
  }

  /** Return the share of the way from the former frame's poses to the latest. */
  async advance() {
    return Math.min((performance.now() - this.arrived) / this.interval, 1);
  }

  #send(message) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  #connect() {
    this.socket = new WebSocket(new URL("socket", location.href.replace(/^http/, "ws")));
    this.socket.binaryType = "arraybuffer";
    this.socket.onopen = () => this.ready && this.listener.tell("Connected again");
    this.socket.onmessage = ({ data }) => {
      if (typeof data === "string") this.#hear(JSON.parse(data));
      else this.#receive(data);
    };
    this.socket.onclose = () => {
      if (!this.ready) this.listener.refused(new Problem("The server of this page does not answer."));
      else this.listener.lost();
      if (this.ready) setTimeout(() => this.#connect(), AGAIN);
    };
  }

  #hear({ type, ...message }) {
    if (type === "tell") this.listener.tell(message.text);
    if (type === "run") this.next = { about: message.about, state: { ...this.state }, poses: null };
    if (type === "state") Object.assign((this.next ?? this).state, message);
    if (type === "state" && !this.next) this.#join();
  }

  #receive(buffer) {
    const [kind] = new Int32Array(buffer, 0, 1);
    if (kind === MODEL && this.next) this.next.model = arraysOf(buffer, 4);
    else if (kind === MODEL) this.changed = arraysOf(buffer, 4); // another body of the same robot
    const target = this.next ?? this;
    if (kind !== FRAME || !target.model) return;
    const now = performance.now();
    this.interval = Math.min(Math.max(now - this.arrived, 10), 100);
    this.arrived = now;
    if (this.changed && !this.next) Object.assign(this, { model: this.changed, scene: { reshaped: true } });
    this.changed = null;
    target.poses = posesOf(new Float32Array(buffer, 4), target.model.nbody);
    if (this.next) return this.#begin();
    this.#join();
    this.listener.step();
  }

  /** Go on with another run, all parts of which have come. */
  #begin() {
    if (this.next.state.robots?.length !== this.next.poses.length) return;
    Object.assign(this, this.next, { next: null, scene: {} });
    this.#join();
    if (this.ready) this.listener.renew();
    else this.listener.ready();
    this.ready = true;
  }

  /** Give each robot its pose, if both are known, and the task its front, which training renews. */
  #join() {
    const { robots, front } = this.state;
    if (front !== this.about.front) this.about = { ...this.about, front };
    if (robots.length !== this.poses.length) return;
    if (robots.length !== this.robots.length) this.scene = {};
    this.robots = robots.map((robot, i) => Object.assign(robot, this.poses[i]));
  }
}

function posesOf(numbers, nbody) {
  const poses = [];
  for (let at = 0; at < numbers.length; ) {
    const [steps, contacts, ghosts] = numbers.subarray(at, at + 3);
    const next = (size) => numbers.subarray(at, (at += size));
    at += 3;
    const pose = { steps, places: next(3 * nbody), turns: next(4 * nbody), contacts: next(6 * contacts) };
    poses.push(pose);
    pose.ghost = ghosts ? { places: next(3 * nbody), turns: next(4 * nbody) } : null;
  }
  return poses;
}
