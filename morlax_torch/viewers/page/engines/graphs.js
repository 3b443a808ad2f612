// ONNX models with named inputs and outputs.

import * as ort from "../libraries/ort.js";
import { once, unpacked } from "../files.js";

ort.env.wasm.numThreads = 1; // more need headers that static hosts do not send
ort.env.logLevel = "error";

const started = once(async () => {
  const file = await unpacked(new URL("../libraries/ort.wasm", import.meta.url).href);
  ort.env.wasm.wasmBinary = await file.arrayBuffer();
});

export class Graph {
  /** Inputs have a shape and a type, by name; outputs are names in order, without the file's prefix. */
  static async load(address, inputs, outputs) {
    const [file] = await Promise.all([unpacked(address), started()]);
    const bytes = new Uint8Array(await file.arrayBuffer());
    const session = await ort.InferenceSession.create(bytes);
    return Object.assign(new Graph(), { session, inputs, outputs });
  }

  /** Run the graph; `read(name)` returns an input's numbers. Returns typed arrays by name. */
  async run(read) {
    const feeds = {};
    for (const [name, { shape, type }] of Object.entries(this.inputs)) {
      feeds[name] = new ort.Tensor(type, Array.from(read(name)), shape); // it converts only such arrays
    }
    const results = await this.session.run(feeds);
    const names = this.session.outputNames;
    return Object.fromEntries(this.outputs.map((name, i) => [name, results[names[i]].data]));
  }
}
