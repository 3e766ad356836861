/**
 * The plans of every strategy side by side: what each costs, and what degrades when, on one axis of time.
 *
 * @module
 */

import { h } from "../dom.js";
import { axis, fallRows } from "../plan/axis.js";
import { duration, figure, plannedSeconds } from "../plan/words.js";
import { STRATEGIES, request } from "./request.js";

/**
 * @typedef {import("../store.js").Plan} Plan
 * @typedef {Record<string, Plan | {refused: string}>} Plans by strategy
 */

/** @param {Plan | {refused: string}} plan @returns {plan is Plan} */
function isMade(plan) {
  return !("refused" in plan);
}

/** @param {Plans} plans @returns {[string, Plan][]} those that could be made */
export function madePlans(plans) {
  return Object.entries(plans).flatMap(([name, plan]) => (isMade(plan) ? [/** @type {[string, Plan]} */ ([name, plan])] : []));
}

/**
 * @param {import("../store.js").Ask} ask
 * @param {import("./request.js").Choice} choice
 * @returns {Promise<Plans>} the plan of each strategy, or `{refused}` with the planner's words
 */
export async function plansOfAll(ask, choice) {
  /** @type {Plans} */ const found = {};
  for (const strategy of STRATEGIES) {
    try {
      found[strategy] = await ask("POST", "/plan", request({ ...choice, strategy }));
    } catch (error) {
      found[strategy] = { refused: /** @type {Error} */ (error).message };
    }
  }
  return found;
}

/**
 * @param {Plans} plans by strategy
 * @param {number} width of an axis (px)
 * @param {((strategy: string) => void) | null} onPick
 * @returns {Node[]}
 */
export function comparison(plans, width, onPick) {
  const made = madePlans(plans);
  const span = Math.max(0, ...made.map(([, plan]) => plan.seconds));
  const heads = ["strategy", "disruption", "degrade", "takes about", "critical path", "steps"];
  const rows = Object.entries(plans).map(([name, plan]) => {
    if (!isMade(plan)) return h("tr", {}, h("th", { scope: "row" }, name), h("td", { colspan: 5, class: "refused" }, `refused: ${plan.refused}`));
    const disruption = `${figure(plan.disruption)}${plan.proved_minimal ? " (minimal)" : ""}`;
    const cells = [disruption, plan.degraded.length, duration(plannedSeconds(plan)), duration(plan.makespan), plan.steps.length];
    const head = onPick ? h("button", { class: "button quiet", type: "button", onclick: () => onPick(name) }, name) : name;
    return h("tr", {}, h("th", { scope: "row" }, head), ...cells.map((each) => h("td", { class: "number" }, each)));
  });
  const table = h("table", { class: "figures" }, h("thead", {}, h("tr", {}, ...heads.map((each, index) => h("th", { scope: "col", class: index ? "number" : null }, each)))), h("tbody", {}, ...rows));
  return [
    h("div", { class: "table-wrap", tabindex: 0, role: "region", "aria-label": "Strategies" }, table),
    ...made.flatMap(([name, plan]) => {
      const falls = fallRows(plan);
      const nothing = h("p", { class: "muted" }, "✓ nothing degrades");
      return [
        h("h3", { class: "panel-title" }, `${name}: ${duration(plannedSeconds(plan))}`),
        falls.length ? axis(falls, { width, span, labels: 4, title: `What degrades with ${name}` }) : nothing,
      ];
    }),
  ];
}
