/**
 * The entries of a view, as far as the graph has to tell whether one is drawn as before.
 *
 * @module
 */

import { serviceRows } from "./services.js";

/** @typedef {import("../store.js").Component} Component */

/** @type {WeakMap<Component, string>} */ const signatures = new WeakMap();

/**
 * @param {Component} entry
 * @returns {string} what its shape and its links depend on
 */
export function signature(entry) {
  let found = signatures.get(entry);
  if (found === undefined) {
    found = JSON.stringify([
      [entry.name, entry.role, entry.component, entry.namespace, entry.host],
      entry.functionalities.map(({ name, modes }) => [name, modes]),
      entry.ports.map(({ name, direction, topic }) => [name, direction, topic]),
      serviceRows(entry).map(({ name, direction }) => [name, direction]),
    ]);
    signatures.set(entry, found);
  }
  return found;
}

/**
 * @param {import("../store.js").Crash} crash of a component that was never seen
 * @returns {Component}
 */
export function crashedComponent({ name, role }) {
  const slash = name.lastIndexOf("/");
  const namespace = `/${slash < 0 ? "" : name.slice(0, slash)}`;
  const nothing = { container: null, process: null, node: null, pid: null, host: null, waiting: null, deviation: null, ending: false, done: false, simulated_time: false, run: null, log_file: null };
  const none = { differences: [], undeclared: [], other_nodes: [], other_nodes_unknown: null, functionalities: [], ports: [], parameters: [], endpoints: [] };
  return { name, role: role ?? name, component: "exited", namespace, reachable: false, unreachable: false, answers: false, as_modelled: false, ...nothing, ...none };
}
