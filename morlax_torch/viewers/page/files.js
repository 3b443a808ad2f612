// The page's files.

/** Raised for what a visitor should read as it is. */
export class Problem extends Error {}

/** Fetch a file; a missing one is a `Problem`. */
export async function fetched(address) {
  let response;
  try {
    response = await fetch(address);
  } catch {
    throw new Problem(`The file ${address} cannot be loaded: check the connection.`);
  }
  if (!response.ok) throw new Problem(`The file ${address} is missing on this web server.`);
  return response;
}

export const traffic = { come: 0, due: 0, follow: () => {} }; // bytes of compressed files

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
