// The page's files, and the arrays in them.

const TYPES = { float32: Float32Array, int32: Int32Array };

/** Raised for what a visitor should read as it is. */
export class Problem extends Error {}

/** Fetch a file; a missing one is a `Problem`. */
export async function fetched(address) {
  const response = await fetch(address).catch(() => {
    throw new Problem(`The file ${address} cannot be loaded: check the connection.`);
  });
  if (!response.ok) throw new Problem(`The file ${address} is missing on this web server.`);
  return response;
}

/** Return a function that starts something once for all callers, and again only if it fails. */
export function once(start) {
  let result = null;
  return () =>
    (result ??= start().catch((error) => {
      result = null;
      throw error;
    }));
}

export const traffic = { come: 0, follow: () => {} }; // bytes of compressed files

/** Fetch a file that `pack` compressed, and count its bytes. */
export async function unpacked(address) {
  const { body } = await fetched(`${address}.packed`);
  const count = new TransformStream({
    transform(bytes, out) {
      traffic.come += bytes.length;
      traffic.follow();
      out.enqueue(bytes);
    },
  });
  return new Response(body.pipeThrough(count).pipeThrough(new DecompressionStream("gzip")));
}

/** Return the numbers and arrays of Python's `model_bytes`, by name, from a byte of the buffer on. */
export function arraysOf(buffer, begin = 0) {
  const [length] = new Int32Array(buffer, begin, 1);
  const first = begin + 4 + length;
  const header = new TextDecoder().decode(new Uint8Array(buffer, begin + 4, length));
  const { arrays, ...contents } = JSON.parse(header);
  for (const [name, [type, at, size]] of Object.entries(arrays)) {
    contents[name] = new TYPES[type](buffer, first + at, size);
  }
  return contents;
}
