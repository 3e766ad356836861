/**
 * The fields of a node that is to be added: its name, the topics of each port, and the values of parameters.
 *
 * @module
 */

import { h, replace, valueText } from "../dom.js";
import { kindOf } from "../graph/services.js";

/** @typedef {import("./request.js").Choice} Choice */

export class NewNodeFields {
  /** @type {Partial<Choice>} */ #filled = {};
  #drawn = "";
  #onChoice;

  /** @param {(change: Partial<Choice>) => void} onChoice */
  constructor(onChoice) {
    this.#onChoice = onChoice;
    this.role = /** @type {HTMLInputElement} */ (
      h("input", { class: "button", name: "role", "aria-label": "Name of the new node", placeholder: "name of the new node", autocomplete: "off", spellcheck: "false" })
    );
    this.role.addEventListener("input", () => onChoice({ role: this.role.value.trim() }));
    this.topics = h("datalist", { id: "topics-of-new-node" });
    this.fields = h("div", { class: "change-form wide" });
  }

  /**
   * Shows the ports and parameters of the chosen component. What has been typed stays while they are the same.
   *
   * @param {Api.SpecificationForm | null} specification
   * @param {string} component
   */
  offer(specification, component) {
    const found = specification?.components?.[component] ?? {};
    const ports = [...Object.keys(found.inputs ?? {}), ...(found.outputs ?? [])];
    const parameters = Object.entries(found.parameters ?? {});
    const connectors = { ...specification?.topics, ...specification?.services, ...specification?.actions };
    const key = JSON.stringify([component, ports, parameters]);
    replace(this.topics, ...Object.keys(connectors).sort().map((name) => h("option", { value: name })));
    if (key === this.#drawn) return {};
    this.#drawn = key;
    this.#filled = { topics: {}, values: {} };
    replace(
      this.fields,
      ...ports.flatMap((name) => this.#field("topics", name, `${kindOf(typeOf(found, name))} of ${name}`, "none")),
      ...parameters.flatMap(([name, each]) => this.#field("values", name, name, written(each))),
    );
    return this.#filled;
  }

  /**
   * @param {"topics" | "values"} where
   * @param {string} name of a port or a parameter
   * @param {string} label
   * @param {string} placeholder what holds where nothing is filled in
   * @returns {HTMLElement[]}
   */
  #field(where, name, label, placeholder) {
    const list = where === "topics" ? this.topics.id : null;
    const input = /** @type {HTMLInputElement} */ (h("input", { class: "button", "aria-label": label, placeholder, list, autocomplete: "off", spellcheck: "false" }));
    input.addEventListener("input", () => {
      this.#filled = { ...this.#filled, [where]: { ...this.#filled[where], [name]: input.value } };
      this.#onChoice({ [where]: this.#filled[where] });
    });
    return [h("span", {}, label), input];
  }
}

/**
 * @param {Api.ComponentForm} component
 * @param {string} port
 * @returns {string | null} null for an output that guarantees nothing in any mode
 */
function typeOf({ inputs, functionalities }, port) {
  const modes = Object.values(functionalities ?? {}).flatMap((each) => Object.values(each.modes));
  return inputs?.[port]?.type ?? modes.map((each) => each.guarantees?.[port]?.type).find((type) => type) ?? null;
}

/** @param {unknown} declared a parameter's value, or an object with it */
function written(declared) {
  const value = declared !== null && typeof declared === "object" && "value" in declared ? declared.value : declared;
  return valueText(value);
}
