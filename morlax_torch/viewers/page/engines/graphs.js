// ONNX models with named inputs and outputs.

import * as ort from "../libraries/ort.js";
import { unpacked } from "../files.js";

ort.env.wasm.numThreads = 1; // more need headers that static hosts do not send
ort.env.logLevel = "error";

const ARRAYS = {
  float32: Float32Array,
  float64: Float64Array,
  int64: BigInt64Array,
  int32: Int32Array,
  bool: Uint8Array,
};

/** Convert numbers to the array that ONNX Runtime takes for a type. */
export function typed(type, numbers) {
  if (type === "int64") return BigInt64Array.from(numbers, (x) => BigInt(Math.trunc(Number(x))));
  return ARRAYS[type].from(numbers, Number);
}

let start = null; // ONNX Runtime's own file is loaded once

function started() {
  start ??= unpacked(new URL("../libraries/ort.wasm", import.meta.url).href)
    .then((file) => file.arrayBuffer())
    .then((binary) => (ort.env.wasm.wasmBinary = binary))
    .catch((error) => {
      start = null;
      throw error;
    });
  return start;
}

export class Graph {
  /**
   * @param session of ONNX Runtime.
   * @param inputs shape and type of each input, by name.
   * @param outputs their names in order, without the prefix that the file gives them.
   */
  constructor(session, inputs, outputs) {
    this.session = session;
    this.inputs = inputs;
    this.outputs = outputs;
  }

  static async load(address, inputs, outputs) {
    const [file] = await Promise.all([unpacked(address), started()]);
    const bytes = new Uint8Array(await file.arrayBuffer());
    return new Graph(await ort.InferenceSession.create(bytes), inputs, outputs);
  }

  /** Run the graph; `read(name)` returns an input's numbers. Returns typed arrays by name. */
  async run(read) {
    const feeds = {};
    for (const [name, { shape, type }] of Object.entries(this.inputs)) {
      const given = read(name);
      const data = given instanceof ARRAYS[type] ? given : typed(type, given);
      feeds[name] = new ort.Tensor(type, data, shape);
    }
    const results = await this.session.run(feeds);
    const names = this.session.outputNames;
    return Object.fromEntries(this.outputs.map((name, i) => [name, results[names[i]].data]));
  }

  release() {
    return this.session.release();
  }
}
