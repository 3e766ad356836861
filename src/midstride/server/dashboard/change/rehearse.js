/**
 * What a rehearsal in the simulator has found.
 *
 * @module
 */

import { h, plural } from "../dom.js";

/** @param {any} found as POST /rehearsal answers @param {string} title @returns {Node[]} */
export function rehearsal(found, title) {
  const failed = found.failures ?? [];
  const words = failed.length
    ? `${failed.length} of ${plural(found.runs, "run")} ended as they should not.`
    : `${plural(found.runs, "run")} in the simulator, with faults: each ended as it should.`;
  return [
    h("h2", { class: "panel-title" }, `Rehearsal: ${title}`),
    h("p", { class: "banner", "data-kind": failed.length ? "bad" : "good" }, `${failed.length ? "✕" : "✓"} ${words}`),
    h("ul", {}, ...failed.map((/** @type {any} */ each) => h("li", {}, `seed ${each.seed}: ${each.because}`))),
  ];
}
