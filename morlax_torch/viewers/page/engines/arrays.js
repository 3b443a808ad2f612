// Arrays that Python wrote: a robot's model, and its recording.

const TYPES = { float32: Float32Array, int32: Int32Array };

/** Return the numbers and arrays of Python's `array_bytes`, by name, from a byte of the buffer on. */
export function arraysOf(buffer, begin = 0) {
  const [length] = new Int32Array(buffer, begin, 1);
  const first = begin + 4 + length;
  const { arrays, ...found } = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, begin + 4, length)));
  for (const [name, [type, at, size]] of Object.entries(arrays)) {
    found[name] = new TYPES[type](buffer, first + at, size);
  }
  return found;
}
