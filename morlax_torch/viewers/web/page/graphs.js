// ONNX models with named inputs and outputs.

import * as ort from "./libraries/ort.js";
import { fetched } from "./files.js";

ort.env.wasm.wasmPaths = { wasm: new URL("libraries/ort.wasm", import.meta.url).href };
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
    const bytes = new Uint8Array(await (await fetched(address)).arrayBuffer());
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
