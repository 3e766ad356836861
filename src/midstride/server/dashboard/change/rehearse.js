/**
 * What a rehearsal in the simulator has found.
 *
 * @module
 */

import { h, plural } from "../dom.js";

/** @param {Record<string, number>} counts @returns {string} as "18 done, 2 rolled back" */
function counted(counts) {
  return Object.entries(counts).map(([name, count]) => `${count} ${name.replace("_", " ")}`).join(", ");
}

/** @param {Api.Rehearsal} found as POST /rehearsal answers @param {string} title @returns {Node[]} */
export function rehearsal(found, title) {
  const failed = found.failed ?? [];
  const runs = plural(found.seeds, "run");
  const words = failed.length ? `${failed.length} of ${runs} violate what has to hold.` : `In ${runs}, all that has to hold held.`;
  const faults = Object.entries(found.faults ?? {});
  return [
    h("h2", { class: "panel-title" }, `Rehearsal: ${title}`),
    h("p", { class: "banner", "data-kind": failed.length ? "bad" : "good" }, `${failed.length ? "✕" : "✓"} ${words}`),
    h("p", {}, `How the change ended: ${counted(found.outcomes ?? {}) || "not begun"}.`),
    ...(faults.length ? [table(faults)] : []),
    h("ul", {}, ...failed.map((each) => h("li", {}, `seed ${each.seed}: ${each.problems.join("; ")}`))),
  ];
}

/** @param {[string, Record<string, number>][]} faults by kind: how often each struck, and what followed */
function table(faults) {
  const columns = Object.keys(faults[0][1]);
  const heads = ["fault", ...columns.map((each) => each.replace("_", " "))];
  const rows = faults.map(([name, counts]) =>
    h("tr", {}, h("th", { scope: "row" }, name), ...columns.map((each) => h("td", { class: "number" }, counts[each] || "–"))),
  );
  return h(
    "div",
    { class: "table-wrap", tabindex: 0, role: "region", "aria-label": "Faults" },
    h("table", { class: "figures" }, h("thead", {}, h("tr", {}, ...heads.map((each, index) => h("th", { scope: "col", class: index ? "number" : null }, each)))), h("tbody", {}, ...rows)),
  );
}
