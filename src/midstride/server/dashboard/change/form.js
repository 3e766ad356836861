/**
 * The form in which a change is chosen.
 *
 * @module
 */

import { h, replace } from "../dom.js";
import { STRATEGIES, replacements } from "./request.js";

const KINDS = /** @type {[string, string][]} */ ([
  ["replace", "Replace"],
  ["restart", "Restart"],
  ["remove", "Remove"],
]);

export class Form {
  /** @type {Partial<import("./request.js").Choice>} what the form has filled in */ settled = {};

  /** @param {(change: Partial<import("./request.js").Choice>) => void} onChoice */
  constructor(onChoice) {
    const select = (/** @type {string} */ label, /** @type {string} */ name) => {
      const element = /** @type {HTMLSelectElement} */ (h("select", { class: "button", "aria-label": label, name }));
      element.addEventListener("change", () => onChoice({ [name]: element.value, ...(name === "component" || name === "strategy" ? {} : { component: "" }) }));
      return element;
    };
    const check = (/** @type {string} */ name, /** @type {string} */ words, /** @type {string} */ title) => {
      const box = /** @type {HTMLInputElement} */ (h("input", { type: "checkbox", name }));
      box.addEventListener("change", () => onChoice({ [name]: box.checked }));
      return { box, label: h("label", { title }, box, ` ${words}`) };
    };
    this.kind = select("What to do", "kind");
    this.node = select("Node", "node");
    this.component = select("Component", "component");
    this.strategy = select("Strategy", "strategy");
    this.detours = check("detours", "detours", "Also try to move nodes that stay, and stand-ins: --detours");
    this.declared = check("declared", "declared parameters", "Start with the declared values of parameters: --declared-parameters");
    this.verify = check("verify", "verify", "Verify the plan with Alloy before it starts, and the system after each step: --verify");
    this.with = h("span", {}, "with");
    this.applying = h("p", { class: "wide" });
    this.element = h(
      "div",
      { class: "change-form" },
      this.kind,
      this.node,
      this.with,
      this.component,
      this.applying,
      h("span", {}, "strategy"),
      this.strategy,
      h("div", { class: "change-options wide" }, this.detours.label, this.declared.label, this.verify.label),
    );
    this.file = /** @type {HTMLInputElement} */ (h("input", { class: "visually-hidden", type: "file", accept: ".stride" }));
    this.drop = h("p", { class: "drop" }, "or drop an edited .stride file on the page, or ", h("label", {}, this.file, h("span", {}, "choose one")));
    this.clear = h("button", { class: "button quiet", type: "button", onclick: () => onChoice({ kind: "replace", to: null, file: null }) }, "choose a node instead");
  }

  /**
   * Shows a choice, with what can be chosen in its place.
   *
   * @param {any} specification
   * @param {import("./request.js").Choice} choice
   */
  offer(specification, choice) {
    const applying = choice.kind === "apply";
    const nodes = Object.keys(specification?.nodes ?? {}).sort();
    const node = nodes.includes(choice.node) ? choice.node : (nodes[0] ?? "");
    const found = replacements(specification, node);
    const component = found.some((each) => each.name === choice.component) ? choice.component : (found[0]?.name ?? "");
    fill(this.kind, KINDS, choice.kind);
    fill(this.node, nodes.map((each) => [each, each]), node);
    fill(this.component, found.map((each) => [each.name, each.words ? `${each.name} (${each.words})` : each.name]), component);
    fill(this.strategy, STRATEGIES.map((each) => [each, each]), choice.strategy);
    for (const each of [this.kind, this.node]) each.hidden = applying;
    for (const each of [this.with, this.component]) each.hidden = choice.kind !== "replace";
    this.applying.hidden = !applying;
    replace(this.applying, "Apply ", h("strong", {}, choice.file ?? "a specification"), " ", this.clear);
    this.detours.box.checked = choice.detours;
    this.detours.box.disabled = choice.strategy !== "minimal";
    this.declared.box.checked = choice.declared;
    this.declared.box.disabled = choice.kind === "remove";
    this.verify.box.checked = choice.verify;
    this.settled = applying ? {} : { node, component: choice.kind === "replace" ? component : "" };
  }
}

/**
 * @param {HTMLSelectElement} select
 * @param {string[][]} options value and words
 * @param {string} value
 */
function fill(select, options, value) {
  replace(select, ...options.map(([name, words]) => h("option", { value: name }, words)));
  select.value = value;
}
