/**
 * The selected component or topic: modes and why, ports with what is declared and measured, parameters.
 *
 * @module
 */

import { h, hz, plural, replace, seconds, valueText } from "./dom.js";
import { endpointsContent, serviceContent } from "./endpoints.js";
import { namesIn, owner } from "./graph/names.js";
import { endOf, isService, kindOf } from "./graph/services.js";
import { componentLook, look } from "./modes.js";

/**
 * @typedef {import("./panels.js").Context} Context
 * @typedef {import("./store.js").Component} Component
 * @typedef {import("./store.js").Functionality} Functionality
 * @typedef {import("./store.js").Port} Port
 * @typedef {import("./store.js").View} View
 * @typedef {import("./dom.js").Child} Child
 */

/**
 * @param {HTMLElement} element
 * @param {Context} context
 */
export function mountDetails(element, context) {
  const { store } = context;
  /** @type {Map<string, HTMLElement>} */ let reasons = new Map(); // answers to "why", kept while the selection lasts
  let entry = /** @type {unknown} */ (undefined);
  let crashed = /** @type {unknown} */ (undefined);
  let drawnFor = /** @type {string | null | undefined} */ (undefined);

  const draw = () => {
    const name = store.selected;
    const view = store.view;
    const found = view === null || name === null ? null : name.startsWith("topic:") ? view.topics[name.slice(6)] : view.instances[name];
    if (name === drawnFor && found === entry && crashed === view?.crashed && name !== null) return;
    if (name !== drawnFor) {
      reasons = new Map();
      context.graph.highlight(null);
    }
    [drawnFor, entry, crashed] = [name, found, view?.crashed];
    const focused = document.activeElement instanceof HTMLElement ? document.activeElement.dataset.key : undefined;
    const open = [...element.querySelectorAll("details")].map((each) => each.open);
    replace(element, ...content(name, view, context, reasons, redraw));
    element.querySelectorAll("details").forEach((each, index) => (each.open = open[index] ?? each.open));
    if (focused) /** @type {HTMLElement | null} */ (element.querySelector(`[data-key="${CSS.escape(focused)}"]`))?.focus();
  };
  const redraw = () => {
    entry = null;
    draw();
  };
  draw();
  store.subscribe(["selection", "instances", "topics", "crashed", "time"], draw);
  setInterval(() => {
    for (const each of element.querySelectorAll("[data-since]")) each.textContent = lasting(Number(/** @type {HTMLElement} */ (each).dataset.since), store.now());
  }, 1000);
}

/**
 * @param {string | null} name
 * @param {View | null} view
 * @param {Context} context
 * @param {Map<string, HTMLElement>} reasons
 * @param {() => void} redraw
 * @returns {Child[]}
 */
function content(name, view, context, reasons, redraw) {
  const title = h("p", { class: "panel-title" }, "Selected");
  if (name === null || view === null) {
    return [title, h("p", { class: "muted" }, "Choose a component, a topic or a service on the graph, or search with ", h("kbd", {}, "/"), ".")];
  }
  const close = h("button", { class: "button quiet", type: "button", "aria-label": "Clear the selection", "data-key": "close", onclick: () => context.store.select(null) }, "✕");
  if (name.startsWith("topic:")) return [title, ...topicContent(name.slice(6), view, context, close)];
  const crash = view.crashed.find((each) => each.name === name);
  const component = view.instances[name];
  if (component === undefined && crash === undefined) {
    return [title, heading(name, close), h("p", { class: "muted" }, "It does not run any more.")];
  }
  return [
    title,
    heading(name, close),
    ...(crash === undefined ? [] : crashContent(crash)),
    ...(component === undefined ? [] : componentContent(component, view, context, reasons, redraw)),
  ];
}

/**
 * @param {string} name
 * @param {HTMLElement} close
 * @returns {HTMLElement}
 */
function heading(name, close) {
  return h("div", { class: "title" }, h("h2", {}, name), close);
}

/**
 * @param {import("./store.js").Crash} crash
 * @returns {Child[]}
 */
function crashContent(crash) {
  return [
    h("div", { class: "banner", "data-kind": "bad" }, h("strong", {}, "✕ crashed. "), `${crash.words}.`, crash.respawn ? ` ${crash.respawn.words}` : "", crash.remedy ? ` ${crash.remedy}` : ""),
    crash.log === "" ? null : h("details", {}, h("summary", {}, "The last lines of its output"), h("pre", { tabindex: "0" }, crash.log)),
  ];
}

/**
 * @param {Component} component
 * @param {View} view
 * @param {Context} context
 * @param {Map<string, HTMLElement>} reasons
 * @param {() => void} redraw
 * @returns {Child[]}
 */
function componentContent(component, view, context, reasons, redraw) {
  const place = [component.component, component.role === component.name ? null : `role ${component.role}`, component.node, component.host, component.pid === null ? null : `process ${component.pid}`];
  const found = componentLook(component, view);
  const wrong = [...new Set([component.deviation, ...component.differences, component.waiting && `waiting: ${component.waiting}`])].filter(Boolean);
  return [
    h("p", { class: "muted" }, place.filter(Boolean).join(" · ")),
    found.kind === "gone" && found.words !== "crashed" ? h("p", { class: "banner", "data-kind": "bad" }, `✕ ${found.words}`) : null,
    component.done ? h("p", {}, "✓ Its program has ended as it should (once).") : null,
    wrong.length === 0 ? null : h("ul", { class: "banner", "data-kind": "warn" }, ...wrong.map((each) => h("li", {}, `▲ ${each}`))),
    component.undeclared.length === 0 ? null : h("p", { class: "muted" }, `Topics that are no ports, and so have no gate: ${component.undeclared.join(", ")}`),
    !component.container ? null : h("p", {}, component.process ? `In the container ${component.process}, with others.` : `Left the container ${component.container} for a process for itself; midstride restart ${component.container} brings all of its nodes together.`),
    component.other_nodes.length === 0 ? null : h("p", {}, `Other nodes that end with it: ${component.other_nodes.map((each) => each.name).join(", ")}`),
    component.other_nodes_unknown === null ? null : h("p", { class: "muted" }, `Other nodes of its process are not known: ${component.other_nodes_unknown}`),
    ...component.functionalities.flatMap((each) => functionalityContent(component, each, context, reasons, redraw)),
    ...portsContent(component, context),
    ...endpointsContent(component, view, context.store),
    ...parametersContent(component),
  ];
}

/**
 * @param {Component} component
 * @param {Functionality} functionality
 * @param {Context} context
 * @param {Map<string, HTMLElement>} reasons
 * @param {() => void} redraw
 * @returns {Child[]}
 */
function functionalityContent(component, functionality, context, reasons, redraw) {
  const { name, mode, modes, because, restoring, since } = functionality;
  const { kind, glyph } = look(functionality);
  const ref = `${component.role}.${name}`;
  const why = h("button", { class: "button quiet", type: "button", "data-key": `why ${name}`, onclick: () => void explain(ref, context, reasons, redraw) }, "why?");
  return [
    h("h3", {}, name),
    h(
      "div",
      { "data-kind": kind },
      h(
        "ul",
        { class: "modes", "aria-label": `modes of ${name}, best first` },
        ...modes.map((each) => h("li", { "aria-current": each === mode ? "true" : "false" }, each === mode ? `${glyph} ${each}` : each)),
      ),
      h("p", { class: "because" }, since === null ? null : h("span", { class: "muted", "data-since": since }, lasting(since, context.store.now())), " ", because ?? "", " ", why),
      restoring ? h("p", { class: "muted" }, restoring) : null,
      reasons.get(ref),
    ),
  ];
}

/**
 * @param {number} since
 * @param {number} now
 * @returns {string}
 */
function lasting(since, now) {
  return `for ${seconds(Math.max(0, now - since))}.`;
}

/**
 * Asks why, shows the chain of reasons, and highlights on the graph what it mentions.
 *
 * @param {string} ref
 * @param {Context} context
 * @param {Map<string, HTMLElement>} reasons
 * @param {() => void} redraw
 */
async function explain(ref, { ask, graph, store, say }, reasons, redraw) {
  const place = h("div", { "aria-live": "polite" }, "asking …");
  reasons.get(ref)?.remove();
  reasons.set(ref, place);
  try {
    const answer = await ask("GET", `/why?functionality=${encodeURIComponent(ref)}`);
    const chain = answer.chain.length > 0 ? answer.chain : [answer.because ?? `${ref} is in its ${answer.mode} mode, and nothing lowers it.`];
    const inputs = Object.entries(answer.inputs ?? {}).map(([input, met]) => `${met ? "✓" : "✕"} ${input}`);
    replace(
      place,
      h("ol", { class: "chain" }, ...chain.map((/** @type {string} */ each) => h("li", {}, each))),
      inputs.length === 0 ? null : h("p", { class: "muted" }, `Inputs: ${inputs.join(", ")}`),
      ...(answer.remedies ?? []).map((/** @type {string} */ each) => h("p", {}, `Next: ${each}`)),
    );
    const named = store.view === null ? [] : namesIn(chain, store.view).filter((name) => owner(name) !== answer.instance);
    graph.highlight(named.length > 0 ? [ref, answer.instance, ...named] : null);
  } catch (error) {
    place.remove();
    reasons.delete(ref);
    say(error instanceof Error ? error.message : String(error), { kind: "bad" });
  }
  redraw();
}

/**
 * @param {Component} component
 * @param {Context} context
 * @returns {Child[]}
 */
function portsContent(component, context) {
  if (component.ports.length === 0) return [];
  return [
    h("h3", {}, "Ports"),
    h(
      "table",
      {},
      h("caption", { class: "visually-hidden" }, "Ports: the contract's rate, and the one that is measured"),
      h("thead", {}, h("tr", {}, h("th", { scope: "col" }, "port"), h("th", { scope: "col", class: "number" }, "measured"), h("th", { scope: "col", class: "number" }, "contract"))),
      ...component.ports.map((port) => portRows(port, context)),
    ),
  ];
}

/**
 * @param {Port} port
 * @param {Context} context
 * @returns {HTMLElement}
 */
function portRows(port, { store }) {
  const { topic } = port;
  const low = port.met === false;
  const times = [
    port.age === null ? null : `last ${seconds(port.age)} ago`,
    port.jitter === null ? null : `jitter ${seconds(port.jitter)}`,
    port.longest === null ? null : `longest ${seconds(port.longest)}`,
  ].filter(Boolean);
  const link =
    topic === null
      ? h("span", { class: "muted" }, `attached to no ${kindOf(port.type)}`)
      : h("button", { class: "button quiet mono", type: "button", "data-key": `topic ${port.name} ${topic}`, onclick: () => store.select(`topic:${topic}`) }, topic);
  const end = endOf(port); // of a service: nothing counts its requests
  const figures = [
    h("td", { class: "number", "data-kind": low ? "bad" : "" }, h("span", low ? { class: "mode-text" } : {}, port.rate === null ? "–" : `${low ? "▼ " : ""}${hz(port.rate)} Hz`)),
    h("td", { class: "number" }, port.declared === null ? "–" : `${hz(port.declared)} Hz`),
  ];
  return h(
    "tbody",
    {},
    h(
      "tr",
      {},
      h("td", {}, `${end !== "" ? "⇄" : port.direction === "in" ? "→" : "←"} ${port.name}`),
      ...(end !== "" ? [h("td", { class: "muted", colspan: 2 }, end)] : figures),
    ),
    h(
      "tr",
      { class: "more" },
      h(
        "td",
        { colspan: 3 },
        link,
        port.gate === "closed" ? h("span", { class: "chip", "data-kind": "warn" }, "⊘ gate closed") : null,
        times.length === 0 ? null : h("div", { class: "muted" }, times.join(" · ")),
      ),
    ),
  );
}

/**
 * @param {Component} component
 * @returns {Child[]}
 */
function parametersContent({ parameters }) {
  if (parameters.length === 0) return [];
  return [
    h("h3", {}, "Parameters"),
    h(
      "table",
      {},
      h("caption", { class: "visually-hidden" }, "Parameters and their values"),
      h(
        "tbody",
        {},
        ...parameters.map(({ name, value, declared, set_at_run_time: set }) =>
          h("tr", {}, h("td", {}, name), h("td", { class: "mono" }, valueText(value), set ? h("div", { class: "muted" }, `set at run time; started with ${valueText(declared)}`) : null)),
        ),
      ),
    ),
  ];
}

/**
 * @param {string} name
 * @param {View} view
 * @param {Context} context
 * @param {HTMLElement} close
 * @returns {Child[]}
 */
function topicContent(name, view, { store }, close) {
  const topic = view.topics[name];
  if (isService(name)) return [heading(name, close), ...serviceContent(name, view, store)];
  if (topic === undefined) return [heading(name, close), h("p", { class: "muted" }, "It is not there any more.")];
  const kind = kindOf(topic.type);
  const ends = (/** @type {string} */ title, /** @type {string[]} */ ports) => [
    h("h3", {}, `${title} (${ports.length})`),
    h(
      "ul",
      {},
      ...ports.map((port) =>
        h("li", {}, h("button", { class: "button quiet", type: "button", "data-key": `end ${port}`, onclick: () => store.select(port.slice(0, port.lastIndexOf("."))) }, port)),
      ),
    ),
  ];
  return [
    heading(name, close),
    h("p", { class: "muted" }, kind === "topic" ? "" : `${kind} · `, topic.type, topic.topic === name ? "" : ` · in ROS ${topic.topic}`),
    h(
      "p",
      { class: "banner", "data-kind": topic.satisfied ? "good" : "bad" },
      topic.satisfied ? "● contract satisfied" : "▲ contract not satisfied",
      topic.rate === null ? "" : `: ${hz(topic.rate)} Hz`,
    ),
    ...ends(kind === "topic" ? "Publishers" : "Server", topic.publishers),
    topic.outside.length === 0 ? null : h("p", {}, `⇥ also ${kind === "topic" ? "published" : "served"} by ${plural(topic.outside.length, "node")} outside the system: ${topic.outside.join(", ")}`),
    ...ends(kind === "topic" ? "Subscribers" : "Clients", topic.subscribers),
  ];
}
