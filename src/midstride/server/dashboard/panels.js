/**
 * The parts of the page beside the graph, each with the section of index.html that it fills.
 *
 * @module
 */

import { mountDetails } from "./details.js";
import { mountEvents } from "./events.js";
import { mountTop } from "./top.js";

/**
 * @typedef {Object} Context
 * @property {import("./store.js").Store} store
 * @property {import("./store.js").Ask} ask
 * @property {import("./graph/graph.js").Graph} graph
 * @property {typeof import("./say.js").say} say
 */

/** @type {[string, (element: HTMLElement, context: Context) => void][]} */
export const PANELS = [
  ["#top", mountTop],
  ["#details", mountDetails],
  ["#events", mountEvents],
];
