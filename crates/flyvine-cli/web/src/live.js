// @ts-check
// The live feed: rows of a flight under way over a WebSocket, and the abort button's request.

/**
 * @typedef {{
 *   onRows: (rows: any[]) => void,
 *   onEnd: (end: {text: string, completed: boolean}) => void,
 *   onLost: () => void,
 * }} Listener
 */

/** The folder of the page's own address: it carries the token. */
const base = new URL(".", location.href);

/**
 * Follows the flight until it ends. Each message is a JSON array of rows, in order; a page that opens late, or that
 * fell behind, gets what it lacks in one message.
 * @param {Listener} listener
 */
export function follow(listener) {
  const url = new URL("live", base);
  url.protocol = "ws:";
  const socket = new WebSocket(url);
  let ended = false;
  socket.addEventListener("message", (event) => {
    const message = JSON.parse(event.data);
    if (message.rows.length > 0) listener.onRows(message.rows);
    if (message.end) {
      ended = true;
      listener.onEnd(message.end);
    }
  });
  socket.addEventListener("close", () => {
    if (!ended) listener.onLost();
  });
}

/** Asks the flight loop to abort; true if it got the request. */
export async function requestAbort() {
  try {
    const answer = await fetch(new URL("abort", base), { method: "POST" });
    return answer.ok;
  } catch {
    return false;
  }
}
