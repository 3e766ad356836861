/**
 * The dashboard: puts its parts together, and begins to follow the manager.
 *
 * @module
 */

import { ask } from "./api.js";
import { createGraph } from "./graph/graph.js";
import { mountGraphTools } from "./graph/tools.js";
import { mountKeys } from "./keys.js";
import { PANELS } from "./panels.js";
import { say } from "./say.js";
import { apply, settings } from "./settings.js";
import { createStore } from "./store.js";

/**
 * @param {string} selector
 * @returns {HTMLElement}
 */
function section(selector) {
  const found = document.querySelector(selector);
  if (!(found instanceof HTMLElement)) throw new Error(`the page has no ${selector}`);
  return found;
}

apply();
const store = createStore(ask);
store.connect(); // the view comes while the page is put together
const graph = createGraph(section("#graph"), {
  grouping: settings.grouping,
  onSelect: (name) => store.select(name),
  onBusy: (words) => (section("#busy").textContent = words ?? ""),
});
const context = { store, ask, graph, say };

store.subscribe(["instances", "topics", "crashed", "time"], () => {
  if (store.view !== null) graph.draw(store.view);
});
store.subscribe(["selection"], () => graph.select(store.selected));
for (const [selector, mount] of PANELS) mount(section(selector), context);
mountGraphTools(section("#graph-tools"), context);
mountKeys(context);
