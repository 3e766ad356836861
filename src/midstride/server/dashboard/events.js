/**
 * What happened, newest first.
 *
 * @module
 */

import { clock, h, replace } from "./dom.js";

/** @typedef {import("./store.js").Event} Event */

const SHOWN = 200;
const BAD = new Set("exited up_failed step_failed rollback_failed fenced killed respawn_ended restore_ended not_answering forbidden override finished_despite".split(" "));
const WARN = new Set("degraded rollback rolled_back respawn restore note silence_ended host lock unlock".split(" "));

/**
 * @param {Event} event
 * @returns {{kind: "bad" | "warn" | "", mark: string}}
 */
function weight(event) {
  if (BAD.has(event.kind) || event.outcome === "failed") return { kind: "bad", mark: "✕" };
  if (WARN.has(event.kind) || event.outcome === "rolled_back" || event.outcome === "refused") return { kind: "warn", mark: "!" };
  return { kind: "", mark: event.outcome === "done" ? "✓" : "·" };
}

/**
 * @param {HTMLElement} element
 * @param {import("./panels.js").Context} context
 */
export function mountEvents(element, { store }) {
  const list = h("ol", { class: "event-list" });
  const none = h("p", { class: "muted" }, "Nothing has happened since this page was opened.");
  replace(element, h("h2", { class: "panel-title" }, "Events"), none, list);
  /** @type {Event | undefined} */ let newest;

  const draw = () => {
    const until = store.time.at ?? Infinity;
    const events = store.events.filter((event) => event.at <= until);
    const from = newest === undefined ? -1 : events.indexOf(newest);
    if (from < 0) list.replaceChildren();
    for (const event of events.slice(from + 1).slice(-SHOWN)) list.prepend(line(event));
    while (list.children.length > SHOWN) list.lastElementChild?.remove();
    newest = events.at(-1);
    none.hidden = events.length > 0;
  };
  draw();
  store.subscribe(["events", "time"], draw);
}

/**
 * @param {Event} event
 * @returns {HTMLElement}
 */
function line(event) {
  const { kind, mark } = weight(event);
  return h(
    "li",
    { "data-kind": kind, title: new Date(event.at * 1000).toLocaleString() },
    h("time", {}, clock(event.at)),
    h("span", { class: "mark", "aria-hidden": "true" }, mark),
    h("span", { class: "words" }, event.words),
  );
}
