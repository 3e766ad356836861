/**
 * The timeline of a report: that of the page, over the time of one change, which it takes from the file.
 *
 * @module
 */

import { h } from "../dom.js";
import { mountTimeline } from "../timeline/timeline.js";

/** How much is shown before and after the change, of its length. */
const MARGIN = 0.03;

/**
 * @param {Api.ChangeReport & {timeline: Api.ChangeTimeline}} found the change
 * @param {import("../store.js").View} view
 * @param {import("./graph.js").Drawn} drawn
 * @returns {HTMLElement}
 */
export function reportTimeline(found, view, drawn) {
  const { timeline, change } = found;
  const room = Math.max((timeline.until - timeline.since) * MARGIN, 0.05);
  const fixed = /** @type {[number, number]} */ ([timeline.since - room, timeline.until + room]);
  const past = { command: change.command, began: timeline.since, ended: timeline.until, outcome: change.outcome };
  const document = { ...timeline, oldest: timeline.since, changes: [past] };
  /** @type {Set<(changed: Set<string>) => void>} */ const listeners = new Set();
  const store = {
    view,
    live: view,
    connection: { state: "live" },
    /** @type {import("../store.js").Time} */ time: { at: null, shown: null },
    now: () => fixed[1],
    subscribe: (/** @type {Iterable<string>} */ keys, /** @type {(changed: Set<string>) => void} */ callback) => {
      if ([...keys].includes("time")) listeners.add(callback);
      return () => void listeners.delete(callback);
    },
    scrub: async (/** @type {number | null} */ at) => {
      store.time = { at, shown: at };
      drawn.at(at);
      for (const each of listeners) each(new Set(["time"]));
    },
  };
  const element = h("div", { class: "report-timeline" });
  const say = () => undefined;
  mountTimeline(element, { store, ask: async () => document, graph: drawn.graph, say, fixed });
  return element;
}
