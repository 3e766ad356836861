/**
 * Where things are drawn: computed by elkjs in a worker, and remembered by structure.
 *
 * @module
 */

import { componentSize, groupSize, topicSize, ROW } from "./measure.js";
import { elk } from "./worker.js";

/**
 * @typedef {import("./structure.js").Structure} Structure
 * @typedef {import("./structure.js").DrawnComponent} DrawnComponent
 * @typedef {{x: number, y: number, width: number, height: number}} Box
 * @typedef {[number, number][]} Line
 * @typedef {{width: number, height: number, boxes: Record<string, Box>, lines: Record<string, Line[]>}} Layout
 */

const REMEMBERED = 12;
const STORAGE = "midstride-layouts-1";
/** Above this many shapes the layout settles for less order, and comes in seconds instead of minutes. */
const MANY = 250;
/** Up to this many components and groups a chain is short enough to be seen in one row. */
const WRAP_ABOVE = 8;

/**
 * @param {Structure} structure
 * @returns {Promise<Layout>}
 * @throws {Error} where the worker cannot lay it out
 */
export async function layOut(structure) {
  const known = recall(structure.key);
  if (known !== null) return known;
  const laidOut = await elk.layout(elkGraph(structure));
  const layout = read(laidOut);
  remember(structure.key, layout);
  return layout;
}

// -- what elkjs is asked ------------------------------------------------------------------------------

/**
 * @param {Structure} structure
 * @returns {any} a graph in ELK's JSON
 */
function elkGraph(structure) {
  /** @type {Map<string, any>} */ const groups = new Map();
  /** @type {any[]} */ const children = [];
  for (const group of structure.groups) {
    const node = group.collapsed
      ? { id: group.id, ...groupSize(group.title, group.members.length) }
      : { id: group.id, children: [], layoutOptions: { "elk.padding": "[top=40,left=14,bottom=14,right=14]" } };
    groups.set(group.id, node);
    children.push(node);
  }
  const put = (/** @type {string | null} */ group, /** @type {any} */ node) =>
    (group === null ? children : groups.get(group).children).push(node);
  for (const component of structure.components) put(component.group, componentNode(component));
  for (const topic of structure.topics) put(topic.group, topicNode(topic));
  const edges = structure.links.map((link) => ({
    id: link.id,
    sources: [link.fromPort === null ? outlet(link.from) : `${link.from}.${link.fromPort}`],
    targets: [link.toPort === null ? inlet(link.to) : `${link.to}.${link.toPort}`],
  }));
  const many = structure.components.length + structure.topics.length > MANY;
  const nested = structure.groups.some((each) => !each.collapsed);
  const bundled = structure.links.some((each) => each.bundle);
  const wrapped = !nested && structure.components.length + structure.groups.length > WRAP_ABOVE;
  const overview = structure.components.length === 0;
  const apart = !overview || !isConnected(structure);
  return { id: "root", children, edges, layoutOptions: options({ quick: many || overview, overview, apart, nested, bundled, wrapped }) };
}

/**
 * Whether links lead from each of the collapsed groups and topics to all others.
 *
 * @param {Structure} structure without components
 * @returns {boolean}
 */
function isConnected({ groups, topics, links }) {
  const ids = [...groups, ...topics].map(({ id }) => id);
  /** @type {Map<string, string[]>} */ const beside = new Map(ids.map((id) => [id, []]));
  for (const { from, to } of links) {
    beside.get(from)?.push(to);
    beside.get(to)?.push(from);
  }
  const reached = new Set(ids.slice(0, 1));
  for (const id of reached) for (const other of beside.get(id) ?? []) reached.add(other);
  return reached.size === ids.length;
}

/**
 * @param {{quick: boolean, overview: boolean, apart: boolean, nested: boolean, bundled: boolean, wrapped: boolean}} graph
 *   `quick`: it is large, or what a page of a large system begins with (`overview`: there are groups alone); `apart`: it may
 *   have parts that are not linked; `nested`: there are open groups; `bundled`: room is needed for the labels of bundles
 * @returns {Record<string, string>}
 */
function options({ quick, overview, apart, nested, bundled, wrapped }) {
  return {
    "elk.algorithm": "layered",
    "elk.direction": "RIGHT",
    "elk.edgeRouting": "ORTHOGONAL",
    "elk.hierarchyHandling": nested ? "INCLUDE_CHILDREN" : "INHERIT",
    "elk.json.edgeCoords": "ROOT",
    "elk.json.shapeCoords": "ROOT",
    "elk.spacing.nodeNode": "20",
    "elk.spacing.edgeNode": "14",
    "elk.spacing.edgeEdge": bundled ? "18" : "9",
    "elk.layered.spacing.nodeNodeBetweenLayers": bundled ? "64" : "22",
    "elk.layered.spacing.edgeNodeBetweenLayers": "14",
    "elk.layered.spacing.edgeEdgeBetweenLayers": bundled ? "18" : "9",
    "elk.layered.layering.strategy": quick ? "LONGEST_PATH" : "NETWORK_SIMPLEX",
    "elk.layered.nodePlacement.strategy": quick ? "BRANDES_KOEPF" : "NETWORK_SIMPLEX",
    "elk.layered.thoroughness": quick ? "1" : "7",
    // Things stay in their order when something is added: the eye finds them again. What a page begins with has to be there
    // soon: the first layout costs most by the code that it is the first to run.
    "elk.layered.considerModelOrder.strategy": overview ? "NONE" : "NODES_AND_EDGES",
    "elk.layered.crossingMinimization.greedySwitch.type": overview ? "OFF" : "TWO_SIDED",
    "elk.separateConnectedComponents": String(apart),
    "elk.aspectRatio": wrapped ? "2.6" : "1.6",
    // A long chain goes on below, as text does. elkjs does not wrap what is nested.
    "elk.layered.wrapping.strategy": wrapped ? "MULTI_EDGE" : "OFF",
    "elk.layered.wrapping.additionalEdgeSpacing": "30",
  };
}

/**
 * @param {DrawnComponent} component
 * @returns {any}
 */
function componentNode(component) {
  const size = componentSize(component);
  const port = (/** @type {string} */ side) => (/** @type {string} */ name, /** @type {number} */ index) => ({
    id: `${component.id}.${name}`,
    x: side === "WEST" ? 0 : size.width,
    y: size.portsTop + ROW * index + ROW / 2,
    width: 0,
    height: 0,
    layoutOptions: { "elk.port.side": side },
  });
  return {
    id: component.id,
    width: size.width,
    height: size.height,
    ports: [...component.ins.map(port("WEST")), ...component.outs.map(port("EAST"))],
    layoutOptions: { "elk.portConstraints": "FIXED_POS" },
  };
}

/**
 * @param {import("./structure.js").DrawnTopic} topic
 * @returns {any}
 */
function topicNode({ id, name, rate }) {
  const { width, height } = topicSize(name, rate);
  const port = (/** @type {string} */ end, /** @type {string} */ side, /** @type {number} */ x) => ({
    id: end,
    x,
    y: height / 2,
    width: 0,
    height: 0,
    layoutOptions: { "elk.port.side": side },
  });
  const ports = [port(inlet(id), "WEST", 0), port(outlet(id), "EAST", width)];
  return { id, width, height, ports, layoutOptions: { "elk.portConstraints": "FIXED_POS" } };
}

/**
 * @param {string} id of a topic or a collapsed group
 * @returns {string}
 */
function inlet(id) {
  return id.startsWith("t:") ? `${id} <` : id;
}

/**
 * @param {string} id of a topic or a collapsed group
 * @returns {string}
 */
function outlet(id) {
  return id.startsWith("t:") ? `${id} >` : id;
}

// -- what elkjs answers -------------------------------------------------------------------------------

/**
 * @param {any} root
 * @returns {Layout}
 */
function read(root) {
  /** @type {Layout} */
  const layout = { width: root.width, height: root.height, boxes: {}, lines: {} };
  const visit = (/** @type {any} */ node) => {
    for (const child of node.children ?? []) {
      layout.boxes[child.id] = { x: child.x, y: child.y, width: child.width, height: child.height };
      visit(child);
    }
    for (const edge of node.edges ?? []) {
      layout.lines[edge.id] = (edge.sections ?? []).map((/** @type {any} */ section) =>
        [section.startPoint, ...(section.bendPoints ?? []), section.endPoint].map(({ x, y }) => [x, y]),
      );
    }
  };
  visit(root);
  return layout;
}

// -- what was laid out before -------------------------------------------------------------------------

/** @type {Map<string, Layout>} */ const recent = new Map();

/**
 * @param {string} key
 * @returns {string} short enough for the browser's storage
 */
function digest(key) {
  let a = 0xdeadbeef;
  let b = 0x41c6ce57;
  for (let index = 0; index < key.length; index++) {
    const code = key.charCodeAt(index);
    a = Math.imul(a ^ code, 2654435761);
    b = Math.imul(b ^ code, 1597334677);
  }
  return `${(a >>> 0).toString(36)}-${(b >>> 0).toString(36)}-${key.length}`;
}

/**
 * @param {string} key
 * @returns {Layout | null}
 */
function recall(key) {
  const found = recent.get(key);
  if (found !== undefined) return found;
  try {
    return JSON.parse(localStorage.getItem(STORAGE) ?? "{}")[digest(key)] ?? null;
  } catch {
    return null;
  }
}

/**
 * @param {string} key
 * @param {Layout} layout
 */
function remember(key, layout) {
  recent.set(key, layout);
  if (recent.size > REMEMBERED) recent.delete([...recent.keys()][0]);
  try {
    const stored = Object.entries(JSON.parse(localStorage.getItem(STORAGE) ?? "{}"));
    localStorage.setItem(
      STORAGE,
      JSON.stringify(Object.fromEntries([...stored.slice(1 - REMEMBERED), [digest(key), layout]])),
    );
  } catch {
    // no storage, or it is full: the worker lays it out again
  }
}
