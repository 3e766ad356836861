/**
 * The form in which a change is chosen.
 *
 * @module
 */

import { h, replace, valueText } from "../dom.js";
import { NewNodeFields } from "./newnode.js";
import { STRATEGIES, keepsParameters, mayKeepProcess, replacements } from "./request.js";

const KINDS = /** @type {[string, string][]} */ ([
  ["replace", "Replace"],
  ["restart", "Restart"],
  ["add", "Add"],
  ["remove", "Remove"],
  ["rollback", "Roll back to"],
  ["param", "Set parameter of"],
]);

/**
 * What can be chosen besides what the specification has.
 *
 * @typedef {{versions: [number, string][], parameters: (node: string) => import("../store.js").Parameter[]}} Offered
 */

export class Form {
  /** @type {Partial<import("./request.js").Choice>} what the form has filled in */ settled = {};

  /** @param {(change: Partial<import("./request.js").Choice>) => void} onChoice */
  constructor(onChoice) {
    const select = (/** @type {string} */ label, /** @type {string} */ name) => {
      const element = /** @type {HTMLSelectElement} */ (h("select", { class: "button", "aria-label": label, name }));
      element.addEventListener("change", () => onChoice({ [name]: element.value, ...(["kind", "node"].includes(name) ? { component: "", parameter: "", to: null, version: null } : {}) }));
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
    this.others = check("others", "other nodes", "Also where other nodes end with a process that the change ends: --with-other-nodes");
    this.same = check("same", "same process", "In the process of its container that it is in, with the code that is loaded there: --same-process");
    this.verify = check("verify", "verify", "Verify the plan with Alloy before it starts, and the system after each step: --verify");
    this.with = h("span", {});
    this.added = new NewNodeFields(onChoice);
    this.version = /** @type {HTMLSelectElement} */ (h("select", { class: "button", "aria-label": "Version", name: "version" }));
    this.version.addEventListener("change", () => onChoice({ version: Number(this.version.value) || null, to: null }));
    this.parameter = select("Parameter", "parameter");
    this.value = /** @type {HTMLInputElement} */ (h("input", { class: "button", name: "value", "aria-label": "Value", autocomplete: "off", spellcheck: "false" }));
    this.value.addEventListener("input", () => onChoice({ value: this.value.value.trim() }));
    this.strategyWord = h("span", {}, "strategy");
    this.applying = h("p", { class: "wide" });
    this.element = h(
      "div",
      { class: "change-form", hidden: true },
      this.kind,
      this.node,
      this.added.role,
      this.version,
      this.with,
      this.component,
      this.parameter,
      this.value,
      this.added.fields,
      this.added.topics,
      this.applying,
      this.strategyWord,
      this.strategy,
      h("div", { class: "change-options wide" }, this.detours.label, this.declared.label, this.others.label, this.same.label, this.verify.label),
    );
    this.file = /** @type {HTMLInputElement} */ (h("input", { class: "visually-hidden", type: "file", accept: ".stride" }));
    this.drop = h("p", { class: "drop" }, "or drop an edited .stride file on the page, or ", h("label", {}, this.file, h("span", {}, "choose one")));
    this.clear = h("button", { class: "button quiet", type: "button", onclick: () => onChoice({ kind: "replace", to: null, file: null }) }, "choose a node instead");
  }

  /**
   * Shows a choice, with what can be chosen in its place.
   *
   * @param {Api.SpecificationForm | null} specification
   * @param {import("./request.js").Choice} choice
   * @param {Offered} offered
   */
  offer(specification, choice, { versions, parameters }) {
    this.element.hidden = false; // until then there is nothing to choose from
    const { kind } = choice;
    const nodes = Object.keys(specification?.nodes ?? {}).sort().filter((each) => kind !== "param" || parameters(each).length > 0);
    const node = nodes.includes(choice.node) ? choice.node : (nodes[0] ?? "");
    const adding = kind === "add";
    const found = adding ? Object.keys(specification?.components ?? {}).sort().map((name) => ({ name, words: "" })) : replacements(specification, node);
    const component = found.some((each) => each.name === choice.component) ? choice.component : (found[0]?.name ?? "");
    const known = kind === "param" ? parameters(node) : [];
    const parameter = known.find((each) => each.name === choice.parameter) ?? known[0];
    const version = versions.some(([each]) => each === choice.version) ? choice.version : (versions[0]?.[0] ?? null);
    fill(this.kind, KINDS, kind);
    fill(this.node, nodes.map((each) => [each, each]), node);
    fill(this.component, found.map((each) => [each.name, each.words ? `${each.name} (${each.words})` : each.name]), component);
    fill(this.version, versions.map(([each, words]) => [String(each), `version ${each}: ${words}`]), String(version ?? ""));
    fill(this.parameter, known.map((each) => [each.name, each.name]), parameter?.name ?? "");
    fill(this.strategy, STRATEGIES.map((each) => [each, each]), choice.strategy);
    this.value.placeholder = parameter === undefined ? "" : typeof parameter.value === "string" ? JSON.stringify(parameter.value) : valueText(parameter.value);
    this.with.textContent = adding ? "of component" : kind === "param" ? "" : "with";
    show(kind !== "apply", this.kind);
    show(["replace", "restart", "remove", "param"].includes(kind), this.node);
    show(["replace", "add"].includes(kind), this.with, this.component);
    show(adding, this.added.role, this.added.fields);
    show(kind === "rollback", this.version);
    show(kind === "param", this.parameter, this.value);
    show(kind !== "param", this.strategyWord, this.strategy, this.detours.label, this.others.label, this.verify.label, this.declared.label);
    show(kind === "apply", this.applying);
    replace(this.applying, "Apply ", h("strong", {}, choice.file ?? "a specification"), " ", this.clear);
    this.detours.box.checked = choice.detours;
    this.detours.box.disabled = choice.strategy !== "minimal";
    this.declared.box.checked = choice.declared;
    this.declared.box.disabled = !keepsParameters(choice);
    this.others.box.checked = choice.others;
    const inContainer = mayKeepProcess(specification, { ...choice, node });
    show(inContainer, this.same.label);
    this.same.box.checked = choice.same && inContainer;
    this.verify.box.checked = choice.verify;
    const fields = adding ? this.added.offer(specification, component) : {};
    const others = { replace: { component }, add: { component, ...fields }, rollback: { version }, param: { parameter: parameter?.name ?? "" } };
    const same = choice.same && inContainer;
    this.settled = kind === "apply" ? { same } : { node, component: "", same, .../** @type {any} */ (others)[kind] };
  }
}

/** @param {boolean} shown @param {...HTMLElement} elements */
function show(shown, ...elements) {
  for (const each of elements) each.hidden = !shown;
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
