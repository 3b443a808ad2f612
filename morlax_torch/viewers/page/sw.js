// Keeps the page's files, for visits without a network; main.js keeps those of the first visit.

const NAME = "morlax";

addEventListener("install", () => skipWaiting());
addEventListener("activate", (event) => event.waitUntil(clients.claim()));
addEventListener("fetch", (event) => {
  if (event.request.method === "GET") event.respondWith(answer(event.request));
});

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
