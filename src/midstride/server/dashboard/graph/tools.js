/**
 * The buttons on the graph: zoom, groups, and the picture as a file.
 *
 * @module
 */

import { save } from "../api.js";
import { h, replace } from "../dom.js";
import { change, settings } from "../settings.js";

/** @typedef {import("./groups.js").Grouping} Grouping */

/**
 * @param {HTMLElement} element
 * @param {import("../panels.js").Context} context
 */
export function mountGraphTools(element, { graph, store }) {
  const button = (/** @type {string} */ sign, /** @type {string} */ label, /** @type {() => void} */ run) =>
    h("button", { class: "button", type: "button", title: label, "aria-label": label, onclick: run }, sign);
  const grouping = /** @type {HTMLSelectElement} */ (
    h(
      "select",
      { class: "button", "aria-label": "Group by" },
      h("option", { value: "namespace" }, "by namespace"),
      h("option", { value: "host" }, "by host"),
      h("option", { value: "none" }, "no groups"),
    )
  );
  grouping.value = settings.grouping;
  grouping.addEventListener("change", () => {
    const chosen = /** @type {Grouping} */ (grouping.value);
    change({ grouping: chosen });
    graph.grouping = chosen;
  });
  replace(
    element,
    button("+", "Zoom in", () => graph.viewport.zoom(1.25)),
    button("−", "Zoom out", () => graph.viewport.zoom(0.8)),
    button("⤢", "Show everything", () => graph.viewport.fit()),
    grouping,
    button("▸▸", "Collapse all groups", () => graph.toggleAll(true)),
    button("▾▾", "Open all groups", () => graph.toggleAll(false)),
    button("⇩", "Save the picture as SVG", () =>
      save(new Blob([graph.toSvg()], { type: "image/svg+xml" }), `${store.view?.system ?? "system"}.svg`),
    ),
  );
}
