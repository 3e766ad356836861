/**
 * What of a view is drawn, and how it hangs together: the part of the picture that the layout depends on.
 *
 * A topic is drawn beside its publishers, unless their group is collapsed: then what leaves the group is one bundle for
 * each other group, or a link to the port that receives it.
 *
 * @module
 */

import { groupsOf } from "./groups.js";
import { isService, kindOf, rowLabel, serviceRows, sharedServices } from "./services.js";

/**
 * @typedef {import("../store.js").Component} Component
 * @typedef {import("../store.js").Topic} Topic
 * @typedef {import("../store.js").Port} Port
 * @typedef {import("../store.js").View} View
 * @typedef {import("./groups.js").Group} Group
 * @typedef {import("./groups.js").Grouping} Grouping
 * @typedef {import("./ghosts.js").Ghosts} Ghosts
 *
 * @typedef {{id: string, name: string, label: string, group: string | null, ins: string[], outs: string[],
 *   linked: string[], entry: Component}} DrawnComponent  `linked`: its services that are shared
 * @typedef {{id: string, name: string, group: string | null, rate: number | null, kind: ReturnType<typeof kindOf>}} DrawnTopic
 * @typedef {Group & {collapsed: boolean}} DrawnGroup
 * @typedef {{component: string, port: string, topic: string}} End  a port on a topic
 * @typedef {{id: string, from: string, fromPort: string | null, to: string, toPort: string | null, ends: End[],
 *   topics: string[], services: number, bundle: boolean}} DrawnLink  `services`: how many of `topics` are services
 * @typedef {{components: DrawnComponent[], topics: DrawnTopic[], groups: DrawnGroup[], links: DrawnLink[], key: string}} Structure
 */

/**
 * @param {View} view
 * @param {Component[]} components those of the view, and others that are drawn too: planned ones, crashed ones
 * @param {{grouping: Grouping, isCollapsed: (group: Group) => boolean}} options
 * @returns {Structure}
 */
export function structureOf(view, components, { grouping, isCollapsed }) {
  const sorted = [...components].sort((a, b) => (a.name < b.name ? -1 : 1));
  const groupOf = groupsOf(sorted, grouping);
  /** @type {Map<string, DrawnGroup>} */ const groups = new Map();
  for (const group of new Set(groupOf.values())) {
    groups.set(group.id, { ...group, collapsed: isCollapsed(group) });
  }
  const hidden = (/** @type {string} */ name) => {
    const group = groupOf.get(name);
    return group !== undefined && groups.get(group.id)?.collapsed ? group.id : null;
  };

  /** @type {DrawnComponent[]} */ const drawn = [];
  /** @type {Map<string, {outs: End[], ins: End[]}>} */ const ends = new Map();
  for (const name of topicNames(view, sorted)) ends.set(name, { outs: [], ins: [] });
  const shared = sharedServices(sorted);
  for (const name of [...shared].sort()) ends.set(name, { outs: [], ins: [] });
  for (const entry of sorted) {
    if (hidden(entry.name) === null) drawn.push(drawnComponent(entry, groupOf.get(entry.name) ?? null, shared));
    for (const port of entry.ports) {
      if (port.topic === null) continue;
      const end = { component: entry.name, port: port.name, topic: port.topic };
      ends.get(port.topic)?.[port.direction === "out" ? "outs" : "ins"].push(end);
    }
    for (const { name, direction } of serviceRows(entry)) {
      const end = { component: entry.name, port: name, topic: name };
      ends.get(name)?.[direction === "out" ? "outs" : "ins"].push(end);
    }
  }

  /** @type {Map<string, string | null>} */ const types = new Map();
  for (const { ports } of sorted) for (const { topic, type } of ports) if (topic !== null) types.set(topic, type);
  /** @type {DrawnTopic[]} */ const topics = [];
  /** @type {Map<string, DrawnLink>} */ const links = new Map();
  for (const [name, { outs, ins }] of ends) {
    const group = home(outs.length > 0 ? outs : ins, (end) => groupOf.get(end.component)?.id ?? null);
    const seen = [...outs, ...ins].some((end) => hidden(end.component) === null);
    const shown = !(group !== null && groups.get(group)?.collapsed) && (seen || outs.length + ins.length === 0);
    const kind = isService(name) ? "service" : kindOf(view.topics[name]?.type ?? types.get(name));
    const service = kind !== "topic";
    if (shown) topics.push({ id: `t:${name}`, name, group, rate: view.topics[name]?.rate ?? null, kind });
    const sources = shown ? [place(`t:${name}`, null)] : outs.map((end) => side(end, hidden));
    const targets = ins.map((end) => side(end, hidden));
    if (shown) for (const end of outs) join(links, side(end, hidden), place(`t:${name}`, null), end, name, service);
    for (const source of sources) ins.forEach((end, index) => join(links, source, targets[index], end, name, service));
  }
  const all = [...links.values()];
  return { components: drawn, topics, groups: [...groups.values()], links: all, key: keyOf(drawn, topics, groups, all) };
}

/**
 * @param {View} view
 * @param {Component[]} components
 * @returns {Set<string>}
 */
function topicNames(view, components) {
  const names = new Set(Object.keys(view.topics));
  for (const component of components) {
    for (const port of component.ports) if (port.topic !== null) names.add(port.topic);
  }
  return new Set([...names].sort());
}

/**
 * @param {Component} entry
 * @param {Group | null} group
 * @param {Set<string>} shared services
 * @returns {DrawnComponent}
 */
function drawnComponent(entry, group, shared) {
  const rows = [...entry.ports, ...serviceRows(entry)];
  const names = (/** @type {"in" | "out"} */ direction) => [
    ...new Set(rows.filter((row) => row.direction === direction).map(({ name }) => name)),
  ];
  // In the frame of its namespace, the namespace need not be repeated.
  const prefix = group === null ? "/" : `${group.title.slice(1)}/`;
  const label = entry.name.startsWith(prefix) ? entry.name.slice(prefix.length) : entry.name;
  const linked = serviceRows(entry).flatMap(({ name }) => (shared.has(name) ? [name] : []));
  return { id: `c:${entry.name}`, name: entry.name, label, group: group?.id ?? null, ins: names("in"), outs: names("out"), linked, entry };
}

/**
 * The one group that all ends are in, or null.
 *
 * @param {End[]} ends
 * @param {(end: End) => string | null} groupOf
 * @returns {string | null}
 */
function home(ends, groupOf) {
  const found = new Set(ends.map(groupOf));
  return found.size === 1 ? ([...found][0] ?? null) : null;
}

/** @typedef {{node: string, port: string | null}} Place */

/**
 * @param {string} node
 * @param {string | null} port
 * @returns {Place}
 */
function place(node, port) {
  return { node, port };
}

/**
 * @param {End} end
 * @param {(component: string) => string | null} hidden
 * @returns {Place}
 */
function side(end, hidden) {
  const group = hidden(end.component);
  return group === null ? place(`c:${end.component}`, end.port) : place(group, null);
}

/**
 * @param {Map<string, DrawnLink>} links
 * @param {Place} from
 * @param {Place} to
 * @param {End} end whose figures the link shows
 * @param {string} topic
 * @param {boolean} service whether it is one
 */
function join(links, from, to, end, topic, service) {
  if (from.node === to.node && from.port === null) return; // inside a collapsed group
  const id = `${from.node}${from.port === null ? "" : `.${from.port}`} > ${to.node}${to.port === null ? "" : `.${to.port}`}`;
  let link = links.get(id);
  if (link === undefined) {
    const bundle = from.node.startsWith("g:") || to.node.startsWith("g:");
    link = { id, from: from.node, fromPort: from.port, to: to.node, toPort: to.port, ends: [], topics: [], services: 0, bundle };
    links.set(id, link);
  }
  link.ends.push(end);
  if (link.topics.at(-1) === topic) return;
  link.topics.push(topic);
  if (service) link.services += 1;
}

/**
 * What the layout depends on, as text: equal keys have equal layouts.
 *
 * @param {DrawnComponent[]} components
 * @param {DrawnTopic[]} topics
 * @param {Map<string, DrawnGroup>} groups
 * @param {DrawnLink[]} links
 * @returns {string}
 */
function keyOf(components, topics, groups, links) {
  return JSON.stringify([
    components.map(({ entry, label, group, ins, outs }) => [
      entry.name,
      label,
      entry.component,
      group,
      ins.map((name) => rowLabel(name, entry)),
      outs.map((name) => rowLabel(name, entry)),
      entry.functionalities.map(({ name, modes }) => [name, modes]),
    ]),
    topics.map(({ name, group, rate }) => [name, group, rate]),
    [...groups.values()].map(({ id, collapsed, members }) => [id, collapsed, collapsed ? members.length : 0]),
    links.map(({ id }) => id),
  ]);
}
