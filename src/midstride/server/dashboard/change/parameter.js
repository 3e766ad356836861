/**
 * Parameters of running nodes, as `midstride param set` sets them: at once, without a plan.
 *
 * @module
 */

import { h, valueText } from "../dom.js";
import { valueOf } from "./request.js";

/**
 * @param {import("../store.js").Ask} ask
 * @param {import("./request.js").Choice} choice
 * @returns {Promise<Node[]>} the values as they are now
 * @throws {Error} with the manager's words, or those of the node, which may refuse a value
 */
export async function setParameter(ask, { node, parameter, value }) {
  /** @type {Api.ParametersReport} */ const report = await ask("POST", "/parameters", { node, parameters: { [parameter]: valueOf(value) } });
  return report.parameters.map((each) => {
    const text = valueText(each.value);
    return h("p", { class: "banner", "data-kind": "good" }, `✓ ${report.instance}: ${each.name} = ${text}`);
  });
}
