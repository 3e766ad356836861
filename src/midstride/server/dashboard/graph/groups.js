/**
 * Which components are drawn in one group: those of a namespace, or of a host.
 *
 * @module
 */

/**
 * @typedef {import("../store.js").Component} Component
 * @typedef {"namespace" | "host" | "none"} Grouping
 * @typedef {{id: string, title: string, members: string[]}} Group  members are sorted by name
 */

/** Above this many components, groups are collapsed until they are opened. */
export const COLLAPSE_ABOVE = 50;
const MOST_GROUPS = 40;

/**
 * @param {Component[]} components
 * @param {Grouping} grouping
 * @returns {Map<string, Group>} the group of each component, by its name; without an entry it is drawn outside of groups
 */
export function groupsOf(components, grouping) {
  /** @type {Map<string, Group>} */ const groups = new Map();
  /** @type {Map<string, Group>} */ const found = new Map();
  const keyOf = keys(components, grouping);
  const many = components.length > COLLAPSE_ABOVE;
  for (const component of components) {
    const key = keyOf(component);
    if (key === null || (key === "/" && !many)) continue;
    let group = groups.get(key);
    if (group === undefined) groups.set(key, (group = { id: `g:${key}`, title: key, members: [] }));
    group.members.push(component.name);
    found.set(component.name, group);
  }
  for (const group of groups.values()) group.members.sort();
  return found;
}

/**
 * @param {Component[]} components
 * @param {Grouping} grouping
 * @returns {(component: Component) => string | null}
 */
function keys(components, grouping) {
  if (grouping === "none") return () => null;
  if (grouping === "host") return (component) => component.host ?? "this host";
  // Deep namespaces make too many groups to see: then only their first parts count.
  for (let depth = 8; depth > 1; depth--) {
    if (new Set(components.map((each) => parts(each.namespace, depth))).size <= MOST_GROUPS) {
      return (component) => parts(component.namespace, depth);
    }
  }
  return (component) => parts(component.namespace, 1);
}

/**
 * @param {string} namespace
 * @param {number} depth
 * @returns {string}
 */
function parts(namespace, depth) {
  return `/${namespace.split("/").filter(Boolean).slice(0, depth).join("/")}`;
}
