/**
 * A plan on the graph: what it creates and removes, and which functionalities fall.
 *
 * @module
 */

import { modeEntered } from "../plan/words.js";
import { owner } from "./names.js";

/**
 * @typedef {import("../store.js").Component} Component
 * @typedef {import("../store.js").Port} Port
 * @typedef {import("../store.js").View} View
 * @typedef {"created" | "removed"} Fate
 * @typedef {Object} Ghosts
 * @property {Component[]} planned components that do not run yet, as the plan's steps describe them
 * @property {Map<string, Fate>} components
 * @property {Map<string, Fate>} links by `linkKey`
 * @property {Map<string, string>} falls what becomes of a functionality (as "listener.listen", by role), in words
 * @property {Set<string>} current the components that the step in progress is about
 */

/**
 * @param {string} component
 * @param {string} port
 * @param {string} topic
 * @returns {string}
 */
export function linkKey(component, port, topic) {
  return `${component}.${port} ${topic}`;
}

/**
 * @param {import("../store.js").Plan} plan as POST /plan answers, or the `plan` of a change
 * @param {View} view
 * @param {{step?: number | null}} [options] the step in progress, from 0
 * @returns {Ghosts}
 */
export function ghostsOf(plan, view, { step = null } = {}) {
  /** @type {Ghosts} */
  const ghosts = { planned: [], components: new Map(), links: new Map(), falls: falls(plan), current: new Set() };
  /** @type {Map<string, Component>} */ const planned = new Map();
  const link = (/** @type {string} */ ref, /** @type {string} */ topic, /** @type {Fate} */ fate) => {
    const component = owner(ref);
    const port = ref.slice(component.length + 1);
    ghosts.links.set(linkKey(component, port, topic), fate);
    const entry = planned.get(component);
    if (fate === "created" && entry !== undefined) addPort(entry, port, topic, view);
  };
  (plan.steps ?? []).forEach((each, index) => {
    if (index === step) for (const name of subjects(each)) ghosts.current.add(name);
    if (each.action === "create") {
      ghosts.components.set(each.instance, "created");
      if (!(each.instance in view.instances)) planned.set(each.instance, newComponent(each, view));
    } else if (each.action === "remove") ghosts.components.set(each.instance, "removed");
    else if (each.action === "attach") link(each.port, each.topic, "created");
    else if (each.action === "detach") link(each.port, each.topic, "removed");
    else if (each.action === "handover") {
      for (const swap of each.swaps) {
        link(swap.old, swap.topic, "removed");
        link(swap.new, swap.topic, "created");
      }
    } else if (each.action === "upgrade" || each.action === "degrade") addModes(planned, each.modes);
  });
  ghosts.planned = [...planned.values()];
  return ghosts;
}

/**
 * @param {import("../store.js").Plan} plan
 * @returns {Map<string, string>}
 */
function falls(plan) {
  /** @type {Map<string, string>} */ const found = new Map();
  for (const name of plan.degraded ?? []) found.set(name, "falls");
  for (const each of plan.degradations ?? []) {
    const to = modeEntered(plan.steps[each.from_step - 1], each.functionality);
    found.set(each.functionality, to ? `falls to ${to}` : "falls");
  }
  return found;
}

/**
 * @param {import("../plan/words.js").Step} step
 * @returns {string[]} the components that a step is about
 */
function subjects(step) {
  if ("instance" in step) return [step.instance];
  if ("port" in step) return [owner(step.port)];
  if ("swaps" in step) return step.swaps.flatMap((swap) => [owner(swap.old), owner(swap.new)]);
  return Object.keys(step.modes).map(owner);
}

/**
 * @param {Api.CreateStep} create
 * @param {View} view
 * @returns {Component}
 */
function newComponent(create, view) {
  const before = Object.values(view.instances).find((each) => each.role === create.role);
  const slash = create.role.lastIndexOf("/");
  return {
    name: create.instance,
    role: create.role,
    component: create.component,
    namespace: before?.namespace ?? `/${slash < 0 ? "" : create.role.slice(0, slash)}`,
    host: before?.host ?? null,
    container: create.container?.name ?? null,
    process: create.process || null,
    node: null,
    pid: null,
    reachable: true,
    unreachable: false,
    answers: true,
    ending: false,
    done: false,
    waiting: null,
    as_modelled: true,
    differences: [],
    undeclared: [],
    other_nodes: [],
    other_nodes_unknown: null,
    deviation: null,
    simulated_time: false,
    run: null,
    log_file: null,
    functionalities: [],
    ports: [],
    parameters: [],
    endpoints: before?.endpoints ?? [],
  };
}

/**
 * @param {Component} entry
 * @param {string} port
 * @param {string} topic
 * @param {View} view
 */
function addPort(entry, port, topic, view) {
  const like = Object.values(view.instances)
    .filter((each) => each.role === entry.role || each.component === entry.component)
    .flatMap((each) => each.ports)
    .find((each) => each.name === port);
  const published = (view.topics[topic]?.publishers.length ?? 0) > 0;
  entry.ports.push({
    name: port,
    direction: like?.direction ?? (published ? "in" : "out"),
    functionalities: [],
    topic,
    type: view.topics[topic]?.type ?? null,
    gate: null,
    declared: null,
    rate: null,
    met: null,
    age: null,
    jitter: null,
    longest: null,
    kept_out: false,
  });
}

/**
 * @param {Map<string, Component>} planned
 * @param {Record<string, {from: string, to: string}>} modes
 */
function addModes(planned, modes) {
  for (const [ref, { from, to }] of Object.entries(modes)) {
    const entry = planned.get(owner(ref));
    const name = ref.slice(owner(ref).length + 1);
    if (entry === undefined || entry.functionalities.some((each) => each.name === name)) continue;
    const known = { modelled: to, because: null, reflex: false, restoring: null, since: null };
    entry.functionalities.push({ name, mode: to, modes: [to, from], normal: true, ...known });
  }
}
