/**
 * The keys of the whole page; help.js lists them.
 *
 * @module
 */

import { openHelp } from "./help.js";
import { openSearch } from "./search.js";
import { isDark } from "./settings.js";

/** @param {import("./panels.js").Context} context */
export function mountKeys(context) {
  const { store, graph } = context;
  const press = (/** @type {string} */ label) =>
    /** @type {HTMLElement | null} */ (document.querySelector(`#tools [aria-label="${label}"]`))?.click();
  /** @type {Record<string, () => void>} */
  const keys = {
    "/": () => openSearch(context),
    "?": openHelp,
    Escape: () => {
      store.select(null);
      graph.highlight(null);
    },
    "+": () => graph.viewport.zoom(1.25),
    "-": () => graph.viewport.zoom(0.8),
    0: () => graph.viewport.fit(),
    l: () => press("Large text"),
    d: () => press(isDark() ? "Light colours" : "Dark colours"),
  };
  document.addEventListener("keydown", (event) => {
    const target = /** @type {Element} */ (event.target);
    if (event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented) return;
    if (target.closest("input, textarea, select, dialog, [contenteditable]")) return;
    const run = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (run === undefined) return;
    event.preventDefault();
    run();
  });
}
