// One robot: MuJoCo's physics, the task's own step as ONNX graphs, and the family of policies.

import loadMujoco from "../libraries/mujoco.js";
import { once, unpacked } from "../files.js";
import { Graph } from "./graphs.js";

// the draws of tasks: "uniform" or "integer" in [low, high), or "normal"
const DRAWS = {
  uniform: (low, high) => low + (high - low) * Math.random(),
  normal: (mean, deviation) => mean + deviation * normal(),
  integer: (low, high) => Math.floor(low + (high - low) * Math.random()),
};

function normal() {
  const radius = Math.sqrt(-2 * Math.log(1 - Math.random()));
  return radius * Math.cos(2 * Math.PI * Math.random());
}

const mujoco = once(async () => {
  const file = await unpacked(new URL("../libraries/mujoco.wasm", import.meta.url).href);
  const wasmBinary = await file.arrayBuffer();
  return loadMujoco({ wasmBinary, print: () => {}, printErr: () => {} });
});

export class Simulation {
  static async load(folder) {
    const about = await (await unpacked(`${folder}/run.json`)).json();
    const { objectives, observation_size: O } = about;
    const inputs = {
      observation: { shape: [1, O], type: "float32" },
      tradeoff: { shape: [objectives.length], type: "float32" },
    };
    const [engine, xml, policy, before, after] = await Promise.all([
      mujoco(),
      unpacked(`${folder}/model.xml`).then((file) => file.text()),
      Graph.load(`${folder}/policy.onnx`, inputs, ["action"]),
      Graph.load(`${folder}/before.onnx`, about.before.inputs, about.before.outputs),
      Graph.load(`${folder}/after.onnx`, about.after.inputs, about.after.outputs),
    ]);
    const model = await compiled(engine, folder, xml, about);
    return new Simulation(engine, model, about, { policy, before, after });
  }

  constructor(engine, model, about, graphs) {
    Object.assign(this, { engine, model, about, graphs });
    this.data = new engine.MjData(model);
    this.tradeoff = about.objectives.map(() => 1 / about.objectives.length);
    this.command = about.command?.initial.slice() ?? [];
    this.values = {}; // task state, and what the graphs hand on
    this.ended = null; // the former episode
    this.reset();
  }

  /** Return another robot with the same policy, trade-off and command. */
  twin() {
    const other = new Simulation(this.engine, this.model, this.about, this.graphs);
    return Object.assign(other, { tradeoff: this.tradeoff, command: this.command.slice() });
  }

  /** The bodies' positions, three numbers each. */
  get places() {
    return this.data.xpos;
  }

  /** The bodies' orientations as quaternions, w first. */
  get turns() {
    return this.data.xquat;
  }

  /** The robot's velocity in m/s along x and, if it can move there, y. */
  get velocity() {
    return this.about.pushed.map((dof) => this.data.qvel[dof]);
  }

  /** The motors' mechanical power in watts; absorbed power counts as positive too. */
  get power() {
    const { actuator_force, actuator_velocity } = this.data;
    return actuator_force.reduce((sum, f, i) => sum + Math.abs(f * actuator_velocity[i]), 0);
  }

  /** The control steps that `returns` count. */
  get counted() {
    return this.steps;
  }

  /** Start a new episode after one that is over. */
  restart() {
    const { returns, steps, about } = this;
    this.ended = { returns, seconds: steps * about.dt, fell: this.over === "fell" };
    this.reset();
  }

  /** Start a new episode, from one of the task's initial states. */
  reset(index = Math.floor(Math.random() * this.about.starts.length)) {
    const { observation, ...state } = structuredClone(this.about.starts[index]);
    this.engine.mj_resetData(this.model, this.data);
    this.#keep(state);
    this.observation = observation;
    this.returns = this.about.objectives.map(() => 0);
    this.steps = 0;
    this.over = null;
    this.terms = null; // latest rewards of the task's terms
    this.engine.mj_kinematics(this.model, this.data); // for whoever draws the bodies
  }

  /** Take one control step of `about.dt` seconds. */
  async step() {
    const { policy, before, after } = this.graphs;
    const inputs = { observation: this.observation, tradeoff: this.tradeoff };
    const { action } = await policy.run((name) => inputs[name]);
    this.values.action = action;
    this.command.forEach((value, i) => (this.values.command[this.about.command.offset + i] = value));
    this.#keep(await before.run((name) => this.#read(name, this.about.before)));
    for (let i = 0; i < this.about.substeps; i++) this.engine.mj_step(this.model, this.data);
    const results = await after.run((name) => this.#read(name, this.about.after));
    this.#keep(results);
    this.observation = results.observation;
    this.returns = this.returns.map((sum, i) => sum + results.reward[i]);
    this.steps += 1;
    if (results.terminated[0]) this.over = "fell";
    else if (results.truncated[0]) this.over = "time";
    this.terms = results.terms;
    this.engine.mj_kinematics(this.model, this.data);
    return { action, reward: results.reward };
  }

  /** Return a sudden velocity in a random horizontal direction. */
  kick() {
    const { pushed, push } = this.about;
    const kick = pushed.map(normal);
    const size = Math.hypot(...kick);
    return kick.map((part) => (push * part) / size);
  }

  push(kick) {
    this.about.pushed.forEach((dof, i) => (this.data.qvel[dof] += kick[i]));
  }

  #read(name, graph) {
    if (name in graph.draws) {
      const { kind, parameters } = graph.draws[name];
      const size = graph.inputs[name].shape.reduce((a, b) => a * b, 1);
      return Array.from({ length: size }, () => DRAWS[kind](...parameters));
    }
    const field = this.about.physics[name];
    return field ? this.data[field] : this.values[name];
  }

  #keep(results) {
    for (const [name, numbers] of Object.entries(results)) {
      const field = this.about.physics[name];
      if (field) this.data[field].set(numbers);
      else this.values[name] = numbers;
    }
  }
}

/** Compile a model and write the exact numbers into it that its XML has rounded. */
async function compiled(engine, folder, xml, about) {
  const files = new engine.MjVFS();
  try {
    for (const name of about.assets) {
      const file = await unpacked(`${folder}/${name}`);
      files.addBuffer(name, new Uint8Array(await file.arrayBuffer()));
    }
    const model = engine.MjModel.from_xml_string(xml, files);
    for (const [name, numbers] of Object.entries(about.fields)) {
      if (model[name]?.length === numbers.length) model[name].set(numbers);
    }
    for (const [name, value] of Object.entries(about.options)) {
      if (Array.isArray(value)) model.opt[name]?.set?.(value);
      else if (name in model.opt) model.opt[name] = value;
    }
    return model;
  } finally {
    files.delete();
  }
}
