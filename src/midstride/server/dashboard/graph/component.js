/**
 * The shape of a component: its name, each functionality with its mode, and its ports with what is declared and measured.
 *
 * @module
 */

import { hz, s, set, setText } from "../dom.js";
import { componentLook, deviates, look } from "../modes.js";
import { componentSize, FIGURES, MODES_TOP, ROW, short, STUB } from "./measure.js";
import { isService, isServiceRow, rowLabel } from "./services.js";

/**
 * @typedef {import("../store.js").Component} Component
 * @typedef {import("../store.js").Functionality} Functionality
 * @typedef {import("../store.js").Port} Port
 * @typedef {import("../store.js").View} View
 * @typedef {import("./structure.js").DrawnComponent} DrawnComponent
 * @typedef {import("./ghosts.js").Ghosts} Ghosts
 * @typedef {{group: SVGElement, text: SVGElement, back: SVGElement}} Figures
 */

const FATES = { created: { glyph: "+", words: "planned" }, removed: { glyph: "−", words: "will be removed" } };

/** One component on the graph. `update` writes only what has changed. */
export class ComponentShape {
  /** @type {SVGElement} */ element;
  #inside = s("g", { class: "inside" });
  #filled = false;
  /** @type {{glyph: SVGElement, mode: SVGElement, row: SVGElement}[]} */ #modes = [];
  /** @type {Map<string, {mark: SVGElement, figures: Figures}>} */ #ports = new Map();
  /** @type {SVGElement} */ #glyph;
  /** @type {SVGElement} */ #flag;
  /** @type {SVGElement | null} */ #type = null;
  /** @type {SVGElement} */ #fate;
  /** @type {DrawnComponent} */ #drawn;

  /** @param {DrawnComponent} drawn */
  constructor(drawn) {
    this.#drawn = drawn;
    const { left, inner, height, portsTop } = componentSize(drawn);
    const right = left + inner;
    this.#glyph = s("text", { class: "glyph", x: left + 10, y: 21 }, "●");
    this.#flag = s("text", { class: "flag", x: right - 10, y: 21, "text-anchor": "end" });
    this.#fate = s("text", { class: "fate", x: left, y: -5 });
    const row = (/** @type {number} */ index) => portsTop + ROW * index + ROW / 2;
    this.element = s(
      "g",
      { class: "component mode", role: "button", tabindex: "-1", "data-name": drawn.entry.name },
      s("rect", { class: "halo", x: left - 4, y: -4, width: inner + 8, height: height + 8, rx: 9 }),
      s("rect", { class: "box", x: left, y: 0, width: inner, height, rx: 6 }),
      s("path", { class: "stripe", d: `M${left} 6a6 6 0 0 1 6-6h${inner - 12}a6 6 0 0 1 6 6z` }),
      s("path", { class: "wires", d: this.#wires(left, right, row) }),
      this.#inside,
    );
  }

  /** What cannot be seen from afar is made when it first can: most of the shapes of a large graph are never seen near. */
  #fill() {
    this.#filled = true;
    const { entry, label, ins, outs } = this.#drawn;
    const { left, inner, portsTop } = componentSize(this.#drawn);
    const right = left + inner;
    this.#type = s("text", { class: "type", x: left + 26, y: 34 });
    this.#inside.append(
      this.#glyph,
      s("text", { class: "name", x: left + 26, y: 21 }, short(label)),
      this.#type,
      this.#flag,
      this.#fate,
    );
    entry.functionalities.forEach(({ name }, index) => {
      const y = MODES_TOP + ROW * index + 12;
      const glyph = s("text", { class: "glyph", x: left + 10, y });
      const mode = s("text", { class: "mode-name", x: right - 10, y, "text-anchor": "end" });
      const row = s("g", { class: "mode functionality" }, glyph, s("text", { x: left + 26, y }, short(name)), mode);
      this.#modes.push({ glyph, mode, row });
      this.#inside.append(row);
    });
    if (ins.length + outs.length > 0 && entry.functionalities.length > 0) {
      this.#inside.append(s("path", { class: "rule", d: `M${left} ${portsTop - 4}h${inner}` }));
    }
    ins.forEach((name, index) => this.#addPort(name, "in", left, portsTop + ROW * index + ROW / 2));
    outs.forEach((name, index) => this.#addPort(name, "out", right, portsTop + ROW * index + ROW / 2));
  }

  /**
   * @param {number} left the box's edges
   * @param {number} right
   * @param {(index: number) => number} row
   * @returns {string} a path between the ports and their links: all that is drawn of ports from afar
   */
  #wires(left, right, row) {
    const { entry, ins, outs, linked } = this.#drawn;
    const leads = new Set([...linked, ...entry.ports.flatMap(({ name, topic }) => (topic === null ? [] : [name]))]);
    const wire = (/** @type {string} */ d) => (/** @type {string} */ name, /** @type {number} */ index) =>
      leads.has(name) ? d.replace("y", String(row(index))) : "";
    return [...ins.map(wire(`M${left - FIGURES} yH${left}`)), ...outs.map(wire(`M${right} yh${STUB}`))].join("");
  }

  /**
   * @param {string} name
   * @param {"in" | "out"} direction
   * @param {number} x where the box's edge is
   * @param {number} y
   */
  #addPort(name, direction, x, y) {
    const incoming = direction === "in";
    const service = isServiceRow(name, this.#drawn.entry);
    const mark = service
      ? s("circle", { class: "port", cx: x, cy: y, r: 4.5 })
      : incoming
        ? s("path", { class: "port", d: `M${x - 9} ${y - 4.5}l9 4.5l-9 4.5z` })
        : s("rect", { class: "port", x: x - 4, y: y - 4, width: 8, height: 8, rx: 1.5 });
    const label = s(
      "text",
      { class: "port-name", x: incoming ? x + 10 : x - 10, y: y + 4, "text-anchor": incoming ? "start" : "end" },
      short(rowLabel(name, this.#drawn.entry)),
    );
    const middle = x - 12 - (FIGURES - 16) / 2;
    const back = s("rect", { class: "figures-back", y: y - 7.5, height: 15, rx: 7.5 });
    const text = s("text", { class: "figures-text", x: middle, y: y + 3.7, "text-anchor": "middle" });
    const group = s("g", { class: "figures" }, back, text);
    const wire = s("path", { class: "wire", d: incoming ? `M${x - FIGURES} ${y}H${x}` : `M${x} ${y}h${STUB}` });
    // What an output writes is measured at its topic; its gate is shown here.
    const port = s("g", { class: service ? "port-row service" : "port-row", "data-direction": direction }, wire, mark, label, incoming ? group : null);
    this.#inside.append(port);
    set(back, "x", middle);
    this.#ports.set(`${direction} ${name}`, { mark: port, figures: { group, text, back } });
  }

  /**
   * @param {Component} entry
   * @param {View} view
   * @param {Ghosts | null} ghosts
   * @param {import("./viewport.js").Detail} detail modes and ports are as they were while only shapes are drawn
   */
  update(entry, view, ghosts, detail) {
    const found = componentLook(entry, view);
    const fate = ghosts?.components.get(entry.name) ?? null;
    const planned = fate === "created" && !(entry.name in view.instances);
    set(this.element, "data-kind", found.kind);
    set(this.element, "data-fate", fate ?? "");
    set(this.element, "data-planned", String(planned));
    set(this.element, "data-current", String(ghosts?.current.has(entry.name) ?? false));
    setText(this.#glyph, planned ? "+" : found.glyph);
    const flagged = deviates(entry) && found.kind === "normal";
    set(this.element, "data-deviates", String(flagged));
    setText(this.#flag, flagged ? "▲" : entry.ending ? "ending" : "");
    setText(this.#fate, fate === null ? "" : `${FATES[fate].glyph} ${planned || fate === "removed" ? FATES[fate].words : "new"}`);
    const words = description(entry, view, fate === null ? "" : planned ? "planned" : FATES[fate].words);
    set(this.element, "aria-label", words);
    if (detail === "shapes") return;
    if (!this.#filled) this.#fill();
    // Below the name, where there is room for it.
    if (this.#type !== null) setText(this.#type, found.kind === "gone" || entry.done ? found.words : short(entry.component));
    entry.functionalities.forEach((functionality, index) => this.#updateMode(functionality, index, entry, ghosts));
    this.#updatePorts(entry);
  }

  /**
   * @param {Functionality} functionality
   * @param {number} index
   * @param {Component} entry
   * @param {Ghosts | null} ghosts
   */
  #updateMode(functionality, index, entry, ghosts) {
    const shape = this.#modes[index];
    if (shape === undefined) return;
    const { kind, glyph, words } = look(functionality);
    const falls = ghosts?.falls.get(`${entry.role}.${functionality.name}`);
    set(shape.row, "data-kind", kind);
    set(shape.row, "data-falls", String(falls !== undefined));
    setText(shape.glyph, falls === undefined ? glyph : "↓");
    setText(shape.mode, falls === undefined ? short(words) : `${short(words)} ↓`);
  }

  /** @param {Component} entry */
  #updatePorts(entry) {
    for (const [key, shape] of this.#ports) {
      const space = key.indexOf(" ");
      const service = key.slice(space + 1);
      if (isService(service)) {
        set(shape.mark, "data-linked", String(this.#drawn.linked.includes(service)));
        continue;
      }
      const links = entry.ports.filter(
        (port) => port.direction === key.slice(0, space) && port.name === key.slice(space + 1),
      );
      const port = links.find((each) => each.met === false) ?? links[0];
      const text = port === undefined || port.direction === "out" ? "" : figuresOf(port);
      set(shape.mark, "data-state", port === undefined ? "" : stateOf(port));
      set(shape.mark, "data-linked", String(links.some((each) => each.topic !== null)));
      if (shape.figures.text.textContent === text) continue;
      shape.figures.text.textContent = text;
      const width = text === "" ? 0 : Math.min(FIGURES - 12, 10 + text.length * 5.8);
      const middle = Number(shape.figures.text.getAttribute("x"));
      set(shape.figures.back, "x", middle - width / 2);
      set(shape.figures.back, "width", width);
    }
  }

  get drawn() {
    return this.#drawn;
  }
}

/**
 * @param {Port} port
 * @returns {"low" | "closed" | "met" | "unknown"}
 */
export function stateOf(port) {
  if (port.met === false) return "low";
  if (port.gate === "closed") return "closed";
  return port.met === true ? "met" : "unknown";
}

/**
 * The measured and the declared rate of a port. A glyph says what the colour says.
 *
 * @param {Port} port
 * @returns {string} as "9.98 / 10 Hz", "▼ 4.1 / 10 Hz", "closed"
 */
function figuresOf(port) {
  if (port.topic === null) return "";
  if (port.gate === "closed") return "⊘ closed";
  if (port.declared === null) return port.rate === null ? "" : `${hz(port.rate)} Hz`;
  const measured = port.rate === null ? "–" : hz(port.rate);
  return `${port.met === false ? "▼ " : ""}${measured} / ${hz(port.declared)} Hz`;
}

/**
 * @param {Component} entry
 * @param {View} view
 * @param {string} fate
 * @returns {string} what a screen reader says, and a pointer shows
 */
function description(entry, view, fate) {
  const parts = [`${entry.name}, a ${entry.component}`];
  if (fate !== "") parts.push(fate);
  const found = componentLook(entry, view);
  if (found.kind === "gone" || entry.done) parts.push(found.words);
  parts.push(...entry.functionalities.map((each) => `${each.name}: ${each.mode}`));
  if (entry.deviation) parts.push(entry.deviation);
  return parts.join("; ");
}
