// Keeps the page's files, for visits without a network.

const NAME = "morlax";

addEventListener("install", () => skipWaiting());
addEventListener("activate", (event) => event.waitUntil(clients.claim()));
addEventListener("message", (event) => event.waitUntil(keep(event.data)));
addEventListener("fetch", (event) => {
  if (event.request.method === "GET") event.respondWith(answer(event.request));
});

/** Fetch the files that are not kept yet: those that the page had before this worker. */
async function keep(addresses) {
  const kept = await caches.open(NAME);
  for (const address of addresses) {
    if (!(await kept.match(address))) await kept.add(address);
  }
}

async function answer(request) {
  const kept = await caches.open(NAME);
  try {
    const response = await fetch(request);
    if (response.ok) await kept.put(request, response.clone());
    return response;
  } catch (error) {
    const former = await kept.match(request, { ignoreSearch: true });
    if (former) return former;
    throw error;
  }
}
