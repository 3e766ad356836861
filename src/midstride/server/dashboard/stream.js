/**
 * The stream of the live view: read with `fetch`, which can send a token and tells why it ended, as EventSource cannot.
 *
 * A lost connection is tried again after 0.5 s, then twice as long each time up to 8 s, and resumed at the last message.
 *
 * @module
 */

import { ApiError, request } from "./api.js";

const FIRST_RETRY = 0.5;
const LAST_RETRY = 8;
const SILENCE = 25; // seconds without a byte: the other end is gone, though nothing said so

/**
 * @typedef {Object} Listener
 * @property {(document: Api.SystemView) => void} view
 * @property {(patch: Api.Patch) => void} patch
 * @property {(event: Api.Event) => void} event
 * @property {(connection: Omit<import("./store.js").Connection, "since">) => void} connection
 * @property {(at: number) => void} clock the time at the manager when a connection opens (unix seconds), up to 2 s old
 */

/**
 * Splits a stream of server-sent events into messages.
 *
 * @param {(message: {id: string | null, type: string, data: string}) => void} deliver
 * @returns {(text: string) => void} takes the text as it comes, in any pieces
 */
export function messages(deliver) {
  /** @type {string[]} */ let rest = []; // pieces of a line that has not ended: a view is a line of a megabyte
  let id = /** @type {string | null} */ (null);
  let type = "message";
  /** @type {string[]} */ let data = [];
  return (text) => {
    const lines = text.split("\n");
    const last = lines.pop() ?? "";
    if (lines.length === 0) {
      rest.push(last);
      return;
    }
    lines[0] = rest.join("") + lines[0];
    rest = [last];
    for (const raw of lines) {
      const line = raw.endsWith("\r") ? raw.slice(0, -1) : raw;
      if (line === "") {
        if (data.length > 0) deliver({ id, type, data: data.join("\n") });
        type = "message";
        data = [];
        continue;
      }
      const colon = line.indexOf(":");
      if (colon === 0) continue; // a comment keeps the connection open
      const field = colon < 0 ? line : line.slice(0, colon);
      const value = colon < 0 ? "" : line.slice(colon + 1).replace(/^ /, "");
      if (field === "id") id = value;
      else if (field === "event") type = value;
      else if (field === "data") data.push(value);
    }
  };
}

/**
 * Follows the live view for as long as the page lives.
 *
 * @param {Listener} listener
 */
export async function follow(listener) {
  let last = /** @type {string | null} */ (null);
  let pause = FIRST_RETRY;
  for (;;) {
    let because = "the manager has closed the connection";
    let state = /** @type {"lost" | "refused"} */ ("lost");
    try {
      await once(last, (message) => {
        last = message.id ?? last;
        pause = FIRST_RETRY;
        dispatch(listener, message);
      }, (at) => {
        if (!Number.isNaN(at)) listener.clock(at);
        listener.connection({ state: "live", because: null, retryAt: null });
      });
    } catch (error) {
      if (error instanceof ApiError) {
        because = error.message;
        if (error.status === 401 || error.status === 403) state = "refused";
      } else if (error instanceof Error) because = error.message;
    }
    listener.connection({ state, because, retryAt: Date.now() / 1000 + pause });
    await retryTime(pause);
    pause = Math.min(2 * pause, LAST_RETRY);
  }
}

/**
 * @param {Listener} listener
 * @param {{type: string, data: string}} message
 */
function dispatch(listener, { type, data }) {
  if (type === "view" || type === "patch" || type === "event") listener[type](JSON.parse(data));
}

/**
 * One connection, until it ends.
 *
 * @param {string | null} last the id of the last message
 * @param {(message: {id: string | null, type: string, data: string}) => void} deliver
 * @param {(at: number) => void} opened with the time at the manager (unix seconds), NaN where that is not said
 */
async function once(last, deliver, opened) {
  const giveUp = new AbortController();
  let silent = false;
  let timer = 0;
  const heard = () => {
    clearTimeout(timer);
    timer = window.setTimeout(() => {
      silent = true;
      giveUp.abort();
    }, SILENCE * 1000);
  };
  heard();
  try {
    /** @type {Record<string, string>} */
    const headers = { Accept: "text/event-stream" };
    if (last !== null) headers["Last-Event-ID"] = last;
    const response = await request("/view/stream", { headers, signal: giveUp.signal });
    if (response.body === null) throw new Error("this browser cannot read a stream");
    opened(Date.parse(response.headers.get("Date") ?? "") / 1000);
    const reader = response.body.getReader();
    const decoder = new TextDecoder();
    const take = messages(deliver);
    for (;;) {
      const { done, value } = await reader.read();
      if (done) return;
      heard();
      take(decoder.decode(value, { stream: true }));
    }
  } catch (error) {
    if (silent) throw new Error(`nothing came from the manager for ${SILENCE} s`);
    if (error instanceof ApiError) throw error;
    throw new Error("the connection to the manager broke");
  } finally {
    clearTimeout(timer);
    giveUp.abort();
  }
}

/**
 * Waits, but no longer than until the browser is online again or the page is looked at again.
 *
 * @param {number} pause in seconds
 * @returns {Promise<void>}
 */
function retryTime(pause) {
  return new Promise((resolve) => {
    const go = () => {
      clearTimeout(timer);
      removeEventListener("online", go);
      document.removeEventListener("visibilitychange", visible);
      resolve();
    };
    const visible = () => {
      if (document.visibilityState === "visible") go();
    };
    const timer = setTimeout(go, pause * 1000);
    addEventListener("online", go);
    document.addEventListener("visibilitychange", visible);
  });
}
