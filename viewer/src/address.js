// Where the renderer of this page is: after the program was started again, at another path of the same port. Pages of
// one recording tell each other through the browser's storage, so that one that was left open goes on.

import { readJson } from "./plan.js";

/** Tell other pages where the renderer is, and follow it. name: of the recording's place in the storage. */
export function followAddress(live, name) {
  const place = `gesticulator address ${name}`, { pathname } = location;
  live.path = pathname;
  try { localStorage.setItem(place, JSON.stringify({ path: pathname, token: live.told.token })); } catch { /* a page without storage */ }
  addEventListener("storage", ({ key, newValue }) => {
    if (key !== place || !newValue) return;
    const { path, token } = readJson(newValue);
    if (path !== live.path) live.moved(path, token);
  });
}
