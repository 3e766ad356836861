/**
 * The graph of a view: components, topics and links, in groups that can be collapsed.
 *
 * `draw` may be called with every new view: it writes what has changed, and lays out anew only where the structure has.
 *
 * @module
 */

import { h, plural, replace, s, set } from "../dom.js";
import { ComponentShape } from "./component.js";
import { neighbour } from "./focus.js";
import { ghostsOf } from "./ghosts.js";
import { CollapsedGroup, OpenGroup } from "./group.js";
import { crashedComponent, signature } from "./entries.js";
import { COLLAPSE_ABOVE } from "./groups.js";
import { layOut } from "./layout.js";
import { LinkShape } from "./link.js";
import { Motion } from "./motion.js";
import { owner } from "./names.js";
import { standalone } from "./standalone.js";
import { structureOf } from "./structure.js";
import { mountTips } from "./tips.js";
import { TopicShape } from "./topic.js";
import { Viewport } from "./viewport.js";
import { Writer } from "./writer.js";

/**
 * @typedef {import("../store.js").Component} Component
 * @typedef {import("../store.js").View} View
 * @typedef {import("./groups.js").Group} Group
 * @typedef {import("./groups.js").Grouping} Grouping
 * @typedef {import("./ghosts.js").Ghosts} Ghosts
 * @typedef {import("./layout.js").Box} Box
 * @typedef {import("./layout.js").Layout} Layout
 * @typedef {import("./structure.js").Structure} Structure
 * @typedef {{onSelect?: (name: string | null) => void, onToggle?: (group: string, collapsed: boolean) => void,
 *   onBusy?: (words: string | null) => void, grouping?: Grouping}} Options
 * @typedef {{element: SVGElement, shape: ComponentShape | TopicShape | CollapsedGroup | OpenGroup, sign: string, box: Box | null}} Drawn
 */

export class Graph {
  /** @type {View | null} */ #view = null;
  /** @type {Map<string, Component>} */ #components = new Map();
  /** @type {Map<string, Component>} */ #lastSeen = new Map(); // so that a crashed one stays in its place
  /** @type {Structure | null} */ #structure = null;
  /** @type {string | null} */ #wanted = null;
  /** @type {Map<string, Drawn>} */ #drawn = new Map();
  /** @type {Map<string, LinkShape>} */ #links = new Map();
  /** @type {Map<string, LinkShape[]>} */ #linksOf = new Map();
  /** @type {Map<string, boolean>} */ #choices = new Map(); // collapsed or not, where the user has said so
  /** @type {import("../store.js").Plan | null} */ #plan = null;
  /** @type {number | null} */ #step = null;
  /** @type {Ghosts | null} */ #ghosts = null;
  /** @type {Set<string> | null} */ #lit = null;
  /** @type {string | null} */ #selected = null;
  /** @type {string | null} */ #toReveal = null;
  /** @type {Grouping} */ #grouping;
  #motion = new Motion();
  #writer;
  #options;
  #svg;
  #world;
  #layers;
  #empty;
  viewport;

  /**
   * @param {HTMLElement} element
   * @param {Options} [options]
   */
  constructor(element, options = {}) {
    this.#options = options;
    this.#grouping = options.grouping ?? "namespace";
    const layer = (/** @type {string} */ name) => s("g", { class: `layer ${name}` });
    this.#layers = { frames: layer("frames"), links: layer("links"), nodes: layer("nodes") };
    this.#world = s("g", { class: "world" }, this.#layers.frames, this.#layers.links, this.#layers.nodes);
    this.#svg = s("svg", { class: "graph", role: "group", "aria-label": "Graph of the system" }, this.#world);
    this.#empty = h("p", { class: "graph-empty" });
    element.append(this.#svg, this.#empty);
    this.viewport = new Viewport(this.#svg, this.#world);
    this.viewport.onDetail = () => this.#writer.update(true);
    this.#writer = new Writer(() => ({
      view: this.#view,
      components: this.#components,
      drawn: this.#drawn,
      linksOf: this.#linksOf,
      ghosts: this.#ghosts,
      detail: this.viewport.detail,
    }));
    mountTips(this.#svg);
    this.#svg.addEventListener("click", (event) => this.#onClick(event));
    this.#svg.addEventListener("keydown", (event) => this.#onKey(/** @type {KeyboardEvent} */ (event)));
    this.#svg.addEventListener("focusin", (event) => this.#onFocus(/** @type {Element} */ (event.target)));
  }

  /** @param {View} view */
  draw(view) {
    const before = this.#view;
    this.#view = view;
    if (this.#plan !== null && (before === null || before.instances !== view.instances)) this.#makeGhosts();
    const everything = before === null || before.crashed !== view.crashed;
    const structural = this.#gather(view, everything);
    this.#writer.update(everything);
    if (before === null || structural) this.#restructure();
  }

  /**
   * Shows a plan: what it creates and removes is dashed, and functionalities that fall are marked.
   *
   * @param {import("../store.js").Plan | null} plan as POST /plan answers; null removes it
   * @param {{step?: number | null}} [options] the step in progress, from 0
   */
  ghosts(plan, { step = null } = {}) {
    this.#plan = plan;
    this.#step = step;
    this.#makeGhosts();
    if (this.#view === null) return;
    const structural = this.#gather(this.#view, true);
    this.#writer.update(true);
    if (structural) this.#restructure();
  }

  /** @param {Iterable<string> | null} names of components, functionalities, ports and topics: the rest fades */
  highlight(names) {
    this.#lit = names === null ? null : new Set([...names].flatMap((name) => [name, owner(name)]));
    this.#mark();
  }

  /** @param {string | null} name of a component, or "topic:/name" */
  select(name) {
    this.#selected = name;
    this.#mark();
  }

  /** @param {string} name of a component, or "topic:/name": its group is opened, and it is brought into view */
  reveal(name) {
    const id = name.startsWith("topic:") ? `t:${name.slice(6)}` : `c:${name}`;
    const drawn = this.#drawn.get(id);
    if (drawn?.box) {
      this.viewport.reveal(drawn.box);
      drawn.element.focus({ preventScroll: true });
      return;
    }
    const topic = this.#view?.topics[name.slice(6)];
    const member = name.startsWith("topic:") ? owner(topic?.publishers[0] ?? topic?.subscribers[0] ?? "") : name;
    const group = this.#structure?.groups.find((each) => each.collapsed && each.members.includes(member));
    if (group === undefined) return;
    this.#toReveal = name;
    this.toggle(group.id, false);
  }

  /**
   * @param {string} id of a group
   * @param {boolean} collapsed
   */
  toggle(id, collapsed) {
    this.#choices.set(id, collapsed);
    this.#options.onToggle?.(id, collapsed);
    this.#restructure();
  }

  /** @param {boolean} collapsed */
  toggleAll(collapsed) {
    for (const group of this.#structure?.groups ?? []) this.#choices.set(group.id, collapsed);
    this.#restructure();
  }

  /** @param {Grouping} grouping */
  set grouping(grouping) {
    this.#grouping = grouping;
    this.#restructure();
  }

  /** @returns {string} the picture as a file, with its colours */
  toSvg() {
    return this.viewport.inFull(() => standalone(this.#svg, this.#world));
  }

  // -- from the view to shapes ------------------------------------------------------------------------

  #makeGhosts() {
    this.#ghosts =
      this.#plan === null || this.#view === null ? null : ghostsOf(this.#plan, this.#view, { step: this.#step });
  }

  /**
   * Collects what is drawn: the view's components, planned ones, and crashed ones where they were.
   *
   * @param {View} view
   * @param {boolean} everything
   * @returns {boolean} whether the structure may have changed
   */
  #gather(view, everything) {
    /** @type {Map<string, Component>} */ const found = new Map();
    let structural = false;
    const take = (/** @type {Component} */ entry) => {
      const before = this.#components.get(entry.name);
      if (before !== entry && (before === undefined || signature(before) !== signature(entry))) structural = true;
      found.set(entry.name, entry);
    };
    for (const name in view.instances) take(view.instances[name]);
    for (const entry of this.#ghosts?.planned ?? []) take(entry);
    for (const crash of view.crashed) {
      if (!found.has(crash.name)) take(this.#lastSeen.get(crash.name) ?? crashedComponent(crash));
    }
    if (found.size !== this.#components.size) structural = true;
    if (everything || structural) this.#remember(view);
    this.#components = found;
    return structural;
  }

  /** @param {View} view */
  #remember(view) {
    for (const name in view.instances) this.#lastSeen.set(name, view.instances[name]);
    if (this.#lastSeen.size <= 2 * Object.keys(view.instances).length + 100) return;
    for (const name of this.#lastSeen.keys()) if (!(name in view.instances)) this.#lastSeen.delete(name);
  }

  /** @param {Group} group */
  #isCollapsed(group) {
    return this.#choices.get(group.id) ?? Object.keys(this.#view?.instances ?? {}).length > COLLAPSE_ABOVE;
  }

  async #restructure() {
    const view = this.#view;
    if (view === null) return;
    const structure = structureOf(view, [...this.#components.values()], {
      grouping: this.#grouping,
      isCollapsed: (group) => this.#isCollapsed(group),
    });
    if (structure.key === this.#wanted) return;
    this.#wanted = structure.key;
    const nothing = structure.components.length + structure.topics.length + structure.groups.length === 0;
    replace(this.#empty, nothing ? "No component runs yet." : null);
    const shapes = structure.components.length + structure.topics.length;
    const slow = setTimeout(() => this.#options.onBusy?.(`laying out ${plural(shapes, "shape")} …`), 400);
    try {
      const layout = await layOut(structure);
      if (this.#wanted === structure.key) this.#apply(structure, layout);
    } catch (error) {
      if (this.#wanted !== structure.key) return;
      this.#wanted = null;
      this.#options.onBusy?.(`the graph cannot be laid out: ${error instanceof Error ? error.message : "no reason given"}`);
      return;
    } finally {
      clearTimeout(slow);
    }
    if (this.#wanted === structure.key) this.#options.onBusy?.(null);
  }

  /**
   * @param {Structure} structure
   * @param {Layout} layout
   */
  #apply(structure, layout) {
    this.#motion.finish();
    this.viewport.show(layout);
    const first = this.#structure === null;
    this.#structure = structure;
    const before = this.#drawn;
    this.#drawn = new Map();
    for (const group of structure.groups) {
      const sign = JSON.stringify([group.collapsed, group.title, group.members]);
      this.#keep(before, group.id, sign, () => (group.collapsed ? new CollapsedGroup(group) : new OpenGroup(group)));
    }
    for (const topic of structure.topics) {
      this.#keep(before, topic.id, JSON.stringify([topic.name, topic.rate, topic.kind]), () => new TopicShape(topic));
    }
    for (const each of structure.components) {
      this.#keep(before, each.id, signature(each.entry) + each.label + each.linked, () => new ComponentShape(each));
    }
    for (const [id, { element }] of before) if (this.#drawn.get(id)?.element !== element) element.remove();
    this.#order(layout);
    this.#applyLinks(structure);
    this.#writer.update(true);
    this.#mark();
    this.#move(layout, first);
  }

  /**
   * @param {Map<string, Drawn>} before
   * @param {string} id
   * @param {string} sign
   * @param {() => Drawn["shape"]} make
   */
  #keep(before, id, sign, make) {
    const old = before.get(id);
    if (old !== undefined && old.sign === sign) {
      this.#drawn.set(id, old);
      return;
    }
    const shape = make();
    this.#drawn.set(id, { element: shape.element, shape, sign, box: old?.box ?? null });
  }

  /**
   * Puts shapes into the document from left to right, which is the order of the tab key.
   *
   * @param {Layout} layout
   */
  #order(layout) {
    const sorted = [...this.#drawn].sort(([a], [b]) => {
      const [one, two] = [layout.boxes[a], layout.boxes[b]];
      return (one?.x ?? 0) - (two?.x ?? 0) || (one?.y ?? 0) - (two?.y ?? 0);
    });
    const focused = document.activeElement;
    for (const [, { element, shape }] of sorted) {
      const layer = shape instanceof OpenGroup ? this.#layers.frames : this.#layers.nodes;
      layer.append(element);
      if (!(shape instanceof TopicShape)) (shape instanceof OpenGroup ? element.querySelector(".handle") : element)?.setAttribute("tabindex", "0");
    }
    if (focused instanceof SVGElement && focused.isConnected) focused.focus({ preventScroll: true });
  }

  /** @param {Structure} structure */
  #applyLinks(structure) {
    const before = this.#links;
    this.#links = new Map();
    this.#linksOf = new Map();
    for (const link of structure.links) {
      const old = before.get(link.id);
      const keep = old !== undefined && JSON.stringify(old.drawn) === JSON.stringify(link);
      const shape = keep ? old : new LinkShape(link);
      this.#links.set(link.id, shape);
      for (const { component } of link.ends) {
        const found = this.#linksOf.get(component);
        if (found === undefined) this.#linksOf.set(component, [shape]);
        else if (found.at(-1) !== shape) found.push(shape);
      }
    }
    const shown = new Set(this.#links.values());
    for (const shape of before.values()) if (!shown.has(shape)) shape.element.remove();
    this.#layers.links.append(...[...shown].map((shape) => shape.element));
  }

  /**
   * @param {Layout} layout
   * @param {boolean} first
   */
  #move(layout, first) {
    const moves = [...this.#drawn].map(([id, drawn]) => {
      const to = layout.boxes[id] ?? drawn.box ?? { x: 0, y: 0, width: 0, height: 0 };
      const { shape, element } = drawn;
      const move = {
        element,
        from: first ? null : drawn.box,
        to,
        resize: shape instanceof OpenGroup ? shape.resize.bind(shape) : null,
      };
      drawn.box = to;
      return move;
    });
    set(this.#world, "data-moving", "true");
    for (const [id, link] of this.#links) link.route(layout.lines[id] ?? []);
    for (const link of this.#links.values()) link.update(this.#components, this.#ghosts);
    this.#motion.start(moves, () => {
      set(this.#world, "data-moving", "false");
      const name = this.#toReveal;
      this.#toReveal = null;
      if (name !== null) this.reveal(name);
    });
  }

  #mark() {
    const lit = this.#lit;
    this.#world.classList.toggle("dimmed", lit !== null);
    for (const [id, { element }] of this.#drawn) {
      const name = id.slice(2);
      element.classList.toggle("lit", lit?.has(name) ?? false);
      const selected = this.#selected === (id.startsWith("t:") ? `topic:${name}` : name) || this.#selected === id;
      element.classList.toggle("selected", selected);
      if (element.getAttribute("role") === "button") set(element, "aria-pressed", String(selected));
    }
    for (const { element, drawn } of this.#links.values()) {
      element.classList.toggle(
        "lit",
        drawn.ends.some((end) => lit !== null && lit.has(end.component) && lit.has(end.topic)),
      );
      const near = drawn.ends.some((end) => this.#selected === end.component || this.#selected === `topic:${end.topic}`);
      element.classList.toggle("near", near);
    }
  }

  // -- pointer and keyboard ---------------------------------------------------------------------------

  /** @param {Event} event */
  #onClick(event) {
    if (this.viewport.dragged) return;
    this.#activate(/** @type {Element} */ (event.target));
  }

  /** @param {Element} target */
  #activate(target) {
    const found = /** @type {SVGElement | null} */ (target.closest("[data-name], [data-topic], [data-group]"));
    if (found === null) {
      this.#options.onSelect?.(null);
      return;
    }
    const { name, topic, group } = found.dataset;
    if (group !== undefined) this.toggle(group, found.getAttribute("aria-expanded") === "true");
    else this.#options.onSelect?.(name ?? `topic:${topic}`);
  }

  /** @param {KeyboardEvent} event */
  #onKey(event) {
    const target = /** @type {Element} */ (event.target);
    if (event.altKey || event.ctrlKey || event.metaKey) return;
    if (event.key === "Enter" || event.key === " ") this.#activate(target);
    else {
      const next = neighbour(event.key, target, this.#world.querySelectorAll("[tabindex]"));
      if (next === null) return;
      /** @type {SVGElement} */ (next).focus({ preventScroll: true });
    }
    event.preventDefault();
  }

  /** @param {Element} target */
  #onFocus(target) {
    if (!target.matches(":focus-visible")) return;
    for (const { element, box } of this.#drawn.values()) if (box !== null && element.contains(target)) this.viewport.reveal(box);
  }
}

/**
 * @param {HTMLElement} element
 * @param {Options} [options]
 * @returns {Graph}
 */
export function createGraph(element, options) {
  return new Graph(element, options);
}
