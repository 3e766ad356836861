/**
 * The shapes of a group: a frame around its components, or, collapsed, a square for each of them.
 *
 * What deviates from the specification stays visible in a collapsed group: in its squares, and listed by name.
 *
 * @module
 */

import { plural, s, set, setText } from "../dom.js";
import { componentLook, deviates, KINDS } from "../modes.js";
import { groupSize, LISTED, short, SQUARE } from "./measure.js";
import { owner } from "./names.js";

/**
 * @typedef {import("../store.js").Component} Component
 * @typedef {import("../store.js").View} View
 * @typedef {import("../modes.js").Kind} Kind
 * @typedef {import("./structure.js").DrawnGroup} DrawnGroup
 */

/** The square of each look: full, half, empty, crossed out. */
const SQUARES = /** @type {Record<Kind, string>} */ ({
  normal: "M2 0h7a2 2 0 0 1 2 2v7a2 2 0 0 1-2 2h-7a2 2 0 0 1-2-2v-7a2 2 0 0 1 2-2z",
  reduced: "M2 0h7a2 2 0 0 1 2 2v7a2 2 0 0 1-2 2h-7a2 2 0 0 1-2-2v-7a2 2 0 0 1 2-2zM1.5 1.5v4h8v-4z",
  degraded: "M2 0h7a2 2 0 0 1 2 2v7a2 2 0 0 1-2 2h-7a2 2 0 0 1-2-2v-7a2 2 0 0 1 2-2zM2.5 2.5v6h6v-6z",
  gone: "M0 2l2-2l3.5 3.5l3.5-3.5l2 2l-3.5 3.5l3.5 3.5l-2 2l-3.5-3.5l-3.5 3.5l-2-2l3.5-3.5z",
});

/** On the square of a component that deviates in another way than by its mode. */
const FLAG = "M11 -1v7l-7-7z";

/** A collapsed group. */
export class CollapsedGroup {
  /** @type {SVGElement} */ element;
  /** @type {SVGElement} */ #counts;
  /** @type {Map<string, {square: SVGElement, flag: SVGElement | null, entry: Component | null}>} */ #squares = new Map();
  /** @type {SVGElement[]} */ #listed = [];
  /** @type {DrawnGroup} */ #group;

  /** @param {DrawnGroup} group */
  constructor(group) {
    this.#group = group;
    const { width, height, columns } = groupSize(group.title, group.members.length);
    this.#counts = s("text", { class: "counts", x: 14, y: 38 });
    this.element = s(
      "g",
      { class: "group collapsed", role: "button", tabindex: "-1", "aria-expanded": "false", "data-group": group.id },
      s("rect", { class: "halo", x: -4, y: -4, width: width + 8, height: height + 8, rx: 12 }),
      s("rect", { class: "box", width, height, rx: 8 }),
      s("path", { class: "twist", d: `M${width - 24} 13l8 5l-8 5z` }),
      s("text", { class: "title", x: 14, y: 22 }, short(group.title, 40)),
      this.#counts,
    );
    group.members.forEach((name, index) => {
      const x = 14 + (index % columns) * SQUARE;
      const y = 48 + Math.floor(index / columns) * SQUARE;
      const square = s("path", { class: "square mode", "fill-rule": "evenodd", transform: `translate(${x} ${y})` });
      this.element.append(square);
      this.#squares.set(name, { square, flag: null, entry: null });
    });
    for (let line = 0; line < LISTED; line++) {
      const text = s("text", { class: "listed mode", x: 14, y: height - 8 - (LISTED - 1 - line) * 15 });
      this.#listed.push(text);
      this.element.append(text);
    }
  }

  /**
   * @param {View} view
   * @param {Map<string, Component>} components
   * @param {boolean} everything although an entry is the same: crashes and topics are not in it
   */
  update(view, components, everything) {
    let differs = everything;
    for (const [name, shape] of this.#squares) {
      const entry = components.get(name);
      if (entry === undefined || (shape.entry === entry && !everything)) continue;
      shape.entry = entry;
      const { kind } = componentLook(entry, view);
      const flagged = kind === "normal" && deviates(entry);
      if (shape.square.getAttribute("data-kind") === kind && (shape.flag !== null) === flagged) continue;
      differs = true;
      set(shape.square, "data-kind", kind);
      set(shape.square, "d", SQUARES[kind]);
      shape.flag?.remove();
      shape.flag = flagged ? s("path", { class: "square-flag", d: FLAG, transform: shape.square.getAttribute("transform") }) : null;
      if (shape.flag !== null) shape.square.after(shape.flag);
    }
    if (differs) this.#list(view);
  }

  /** @param {View} view */
  #list(view) {
    /** @type {{kind: Kind, text: string}[]} */ const deviating = [];
    for (const [name, { entry }] of this.#squares) {
      if (entry === null) continue;
      const { kind, glyph, words } = componentLook(entry, view);
      if (kind !== "normal") deviating.push({ kind, text: `${glyph} ${short(name, 20)}: ${short(words, 16)}` });
      else if (deviates(entry)) deviating.push({ kind: "gone", text: `▲ ${short(name, 20)}: rate or contract` });
    }
    for (const { name, satisfied, publishers, subscribers } of Object.values(view.topics)) {
      const within = (publishers.length > 0 ? publishers : subscribers).some((ref) => this.#squares.has(owner(ref)));
      if (!satisfied && within) deviating.push({ kind: "gone", text: `▲ ${short(name, 20)}: contract` });
    }
    deviating.sort((a, b) => KINDS.indexOf(b.kind) - KINDS.indexOf(a.kind));
    const count = plural(this.#group.members.length, "component");
    setText(this.#counts, deviating.length === 0 ? count : `${count} · ${deviating.length} not as specified`);
    this.#listed.forEach((text, line) => {
      const last = line === LISTED - 1 && deviating.length > LISTED;
      const found = deviating[line];
      setText(text, last ? `and ${deviating.length - LISTED + 1} more` : (found?.text ?? ""));
      set(text, "data-kind", last || found === undefined ? "" : found.kind);
    });
    const words = `group ${this.#group.title}, collapsed: ${count}, ${
      deviating.length === 0 ? "all as specified" : deviating.map(({ text }) => text).join(", ")
    }`;
    set(this.element, "aria-label", words);
  }
}

/** The frame of an open group. Its size comes from the layout. */
export class OpenGroup {
  /** @type {SVGElement} */ element;
  /** @type {SVGElement} */ #box = s("rect", { class: "box", rx: 8 });
  /** @type {SVGElement} */ #handle;

  /** @param {DrawnGroup} group */
  constructor(group) {
    this.#handle = s(
      "g",
      {
        class: "handle",
        role: "button",
        tabindex: "-1",
        "aria-expanded": "true",
        "aria-label": `group ${group.title}, ${plural(group.members.length, "component")}`,
        "data-group": group.id,
      },
      s("rect", { class: "halo", x: 8, y: 6, width: 40 + 8 * short(group.title, 40).length, height: 26, rx: 6 }),
      s("path", { class: "twist", d: "M14 16h10l-5 8z" }),
      s("text", { class: "title", x: 31, y: 25 }, short(group.title, 40)),
    );
    this.element = s("g", { class: "group open" }, this.#box, this.#handle);
  }

  /**
   * @param {number} width
   * @param {number} height
   */
  resize(width, height) {
    set(this.#box, "width", width);
    set(this.#box, "height", height);
  }
}
