/**
 * Services and ROS actions on the graph: a row of each component that has one, and a shape between those that share one.
 *
 * They are drawn as ports and topics are, under names that no port or topic has: "service /map/save".
 *
 * @module
 */

/**
 * @typedef {import("../store.js").Component} Component
 * @typedef {{name: string, direction: "in" | "out"}} ServiceRow  `out`: it serves it, or which end it is is not known
 */

/** Other topics of a node, such as /tf, are in its details: most nodes have them. */
const DRAWN = new Set(["service", "ROS action"]);
const SERVICE = /^(service|ROS action) /;

/**
 * @param {Component} entry
 * @returns {ServiceRow[]}
 */
export function serviceRows(entry) {
  const drawn = (entry.endpoints ?? []).filter(({ kind }) => DRAWN.has(kind));
  return drawn.map(({ kind, name, serves }) => ({ name: `${kind} ${name}`, direction: serves === false ? "in" : "out" }));
}

/**
 * The services that components of more than one role have. Two instances of a role are a node that is being replaced.
 *
 * @param {Component[]} components
 * @returns {Set<string>} as "service /map/save"
 */
export function sharedServices(components) {
  /** @type {Map<string, string>} */ const first = new Map();
  /** @type {Set<string>} */ const shared = new Set();
  for (const entry of components) {
    for (const { name } of serviceRows(entry)) {
      const role = first.get(name);
      if (role === undefined) first.set(name, entry.role);
      else if (role !== entry.role) shared.add(name);
    }
  }
  return shared;
}

/**
 * @param {string} name of a port, a topic, or what is drawn as one
 * @returns {boolean}
 */
export function isService(name) {
  return SERVICE.test(name);
}

/**
 * What stands beside the sign of a port. A service of the node itself is written as in a specification.
 *
 * @param {string} name of a port, or of a service that is drawn as one
 * @param {Component} entry
 * @returns {string} as "out", "⇄ ~/reset", "⇄ /map/save"
 */
export function rowLabel(name, entry) {
  if (!isService(name)) return name;
  const full = name.replace(SERVICE, "");
  const own = `${entry.node ?? `/${entry.role}`}/`;
  return `⇄ ${full.startsWith(own) ? `~/${full.slice(own.length)}` : full}`;
}
