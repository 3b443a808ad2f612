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
