/**
 * Services and ROS actions on the graph: a row of each component that has one, and a shape between those that share one.
 *
 * Those that are ports are drawn as such, with the sign and the dotted lines of services. Others are drawn as ports and
 * topics are, under names that no port or topic has: "service /map/save".
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
 * @param {string | null | undefined} type of a port or a topic, as "nav_msgs/srv/GetMap"
 * @returns {"topic" | "service" | "ROS action"} what it belongs to
 */
export function kindOf(type) {
  const folder = (type ?? "").split("/")[1];
  return folder === "srv" ? "service" : folder === "action" ? "ROS action" : "topic";
}

/**
 * @param {{type: string | null, direction: "in" | "out"}} port
 * @returns {string} as "server", "action client"; "" for one of a topic
 */
export function endOf({ type, direction }) {
  const kind = kindOf(type);
  if (kind === "topic") return "";
  return `${kind === "service" ? "" : "action "}${direction === "out" ? "server" : "client"}`;
}

/**
 * @param {string} name of a port, or of a service that is drawn as one
 * @param {Component} entry
 * @returns {boolean}
 */
export function isServiceRow(name, entry) {
  return isService(name) || entry.ports.some((port) => port.name === name && kindOf(port.type) !== "topic");
}

/**
 * What stands beside the sign of a port. A service of the node itself is written as in a specification.
 *
 * @param {string} name of a port, or of a service that is drawn as one
 * @param {Component} entry
 * @returns {string} as "out", "⇄ map", "⇄ ~/reset", "⇄ /map/save"
 */
export function rowLabel(name, entry) {
  if (!isService(name)) return isServiceRow(name, entry) ? `⇄ ${name}` : name;
  const full = name.replace(SERVICE, "");
  const own = `${entry.node ?? `/${entry.role}`}/`;
  return `⇄ ${full.startsWith(own) ? `~/${full.slice(own.length)}` : full}`;
}
