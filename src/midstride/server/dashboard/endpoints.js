/**
 * The details of services, ROS actions and topics that are no ports: those of a component, and the components of one.
 *
 * @module
 */

import { h } from "./dom.js";

/**
 * @typedef {import("./store.js").Component} Component
 * @typedef {import("./store.js").Endpoint} Endpoint
 * @typedef {import("./store.js").View} View
 * @typedef {import("./panels.js").Context["store"]} Store
 * @typedef {import("./dom.js").Child} Child
 */

/**
 * @param {Component} component
 * @param {View} view
 * @param {Store} store
 * @returns {Child[]}
 */
export function endpointsContent({ endpoints }, view, store) {
  if (!endpoints?.length) return [];
  const row = (/** @type {Endpoint} */ each) => {
    const name = nameOf(each);
    const shared = each.kind !== "topic" && withEndpoint(name, view).length > 1;
    const end = each.serves === null ? "" : each.serves ? ", served by it" : ", called by it";
    const shown = shared
      ? h("button", { class: "button quiet mono", type: "button", "data-key": name, onclick: () => store.select(`topic:${name}`) }, each.name)
      : h("span", { class: "mono" }, each.name);
    return h("tr", {}, h("td", {}, shown), h("td", { class: "muted" }, `${each.kind}${end}`));
  };
  return [
    h("h3", {}, "Other endpoints"),
    h("table", {}, h("caption", { class: "visually-hidden" }, "Services, ROS actions and topics that are no ports"), h("tbody", {}, ...endpoints.map(row))),
  ];
}

/**
 * @param {string} name as "service /map/save"
 * @param {View} view
 * @param {Store} store
 * @returns {Child[]}
 */
export function serviceContent(name, view, store) {
  const line = (/** @type {Component} */ each) => {
    const serves = each.endpoints.find((one) => nameOf(one) === name)?.serves ?? null;
    const button = h("button", { class: "button quiet", type: "button", "data-key": `end ${each.name}`, onclick: () => store.select(each.name) }, each.name);
    return h("li", {}, button, serves === null ? "" : serves ? " serves it" : " calls it");
  };
  return [h("h3", {}, "Components that have it"), h("ul", {}, ...withEndpoint(name, view).map(line))];
}

/** @param {Endpoint} endpoint @returns {string} as "service /map/save" */
function nameOf({ kind, name }) {
  return `${kind} ${name}`;
}

/** @param {string} name as "service /map/save" @param {View} view @returns {Component[]} */
function withEndpoint(name, view) {
  return Object.values(view.instances).filter((each) => (each.endpoints ?? []).some((found) => nameOf(found) === name));
}
