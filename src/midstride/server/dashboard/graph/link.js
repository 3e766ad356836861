/**
 * The shape of a link between a port and a topic, or of a bundle of them between collapsed groups.
 *
 * @module
 */

import { plural, s, set, setText } from "../dom.js";
import { stateOf } from "./component.js";
import { linkKey } from "./ghosts.js";

/**
 * @typedef {import("../store.js").Component} Component
 * @typedef {import("./structure.js").DrawnLink} DrawnLink
 * @typedef {import("./ghosts.js").Ghosts} Ghosts
 * @typedef {import("./layout.js").Line} Line
 */

const CORNER = 7;

export class LinkShape {
  /** @type {SVGElement} */ element;
  /** @type {DrawnLink} */ drawn;
  /** @type {SVGElement} */ #path;
  /** @type {SVGElement} */ #head = s("path", { class: "head" });
  /** @type {SVGElement} */ #label = s("text", { class: "label", "text-anchor": "middle" });
  /** @type {SVGElement} */ #back = s("rect", { class: "label-back", height: 16, rx: 8 });
  /** @type {[number, number]} */ #middle = [0, 0];

  /** @param {DrawnLink} drawn */
  constructor(drawn) {
    this.drawn = drawn;
    const kind = `link${drawn.bundle ? " bundle" : ""}${drawn.services === drawn.topics.length ? " service" : ""}`;
    this.#path = s("path", { class: drawn.bundle ? "line" : `${kind} line` });
    this.element = drawn.bundle ? s("g", { class: kind }, this.#path) : this.#path; // most are one path and no more
    if (drawn.bundle) {
      this.element.append(this.#head, this.#back, this.#label);
      set(this.#path, "stroke-width", (1.5 + Math.min(4, Math.log2(1 + drawn.topics.length) * 0.8)).toFixed(1));
    }
  }

  /** @param {Line[]} lines */
  route(lines) {
    set(this.#path, "d", lines.map(rounded).join(""));
    if (!this.drawn.bundle) return;
    const line = lines.at(-1) ?? [];
    set(this.#head, "d", head(line));
    this.#middle = middle(line);
    set(this.#label, "x", this.#middle[0]);
    set(this.#label, "y", this.#middle[1] + 4);
    set(this.#back, "y", this.#middle[1] - 8);
    setText(this.#label, ""); // the next update places it
  }

  /**
   * @param {Map<string, Component>} components
   * @param {Ghosts | null} ghosts
   */
  update(components, ghosts) {
    let low = 0;
    let closed = 0;
    let fate = "";
    for (const { component, port, topic } of this.drawn.ends) {
      const found = components.get(component)?.ports.find((each) => each.name === port && each.topic === topic);
      const state = found === undefined ? "unknown" : stateOf(found);
      if (state === "low") low += 1;
      if (state === "closed") closed += 1;
      fate = ghosts?.links.get(linkKey(component, port, topic)) ?? fate;
    }
    set(this.element, "data-state", low > 0 ? "low" : closed === this.drawn.ends.length && closed > 0 ? "closed" : "met");
    set(this.element, "data-fate", fate);
    if (!this.drawn.bundle) return;
    const text = low > 0 ? `▼ ${low}/${this.drawn.ends.length} low` : counted(this.drawn);
    if (this.#label.textContent === text) return;
    setText(this.#label, text);
    const width = 12 + text.length * 5.7;
    set(this.#back, "x", this.#middle[0] - width / 2);
    set(this.#back, "width", width);
  }
}

/**
 * @param {DrawnLink} drawn
 * @returns {string} as "3 topics, 1 service"
 */
function counted({ topics, services }) {
  const words = [plural(topics.length - services, "topic"), plural(services, "service")];
  return words.filter((each) => !each.startsWith("0 ")).join(", ");
}

/**
 * @param {Line} line
 * @returns {string} a path with rounded corners
 */
function rounded(line) {
  if (line.length === 0) return "";
  const parts = [`M${line[0][0]} ${line[0][1]}`];
  for (let index = 1; index < line.length - 1; index++) {
    const [x, y] = line[index];
    const [before, after] = [towards(line[index], line[index - 1]), towards(line[index], line[index + 1])];
    parts.push(`L${before[0]} ${before[1]}Q${x} ${y} ${after[0]} ${after[1]}`);
  }
  const last = line[line.length - 1];
  parts.push(`L${last[0]} ${last[1]}`);
  return parts.join("");
}

/**
 * @param {[number, number]} from
 * @param {[number, number]} to
 * @returns {[number, number]} the point a corner's radius away from `from`, or half way where that is nearer
 */
function towards([x, y], [toX, toY]) {
  const distance = Math.hypot(toX - x, toY - y) || 1;
  const part = Math.min(CORNER, distance / 2) / distance;
  return [x + (toX - x) * part, y + (toY - y) * part];
}

/**
 * @param {Line} line
 * @returns {string} an arrow head at its end
 */
function head(line) {
  if (line.length < 2) return "";
  const [[fromX, fromY], [x, y]] = [line[line.length - 2], line[line.length - 1]];
  const distance = Math.hypot(x - fromX, y - fromY) || 1;
  const [dx, dy] = [((x - fromX) / distance) * 10, ((y - fromY) / distance) * 10];
  return `M${x} ${y}L${x - dx - dy / 2} ${y - dy + dx / 2}L${x - dx + dy / 2} ${y - dy - dx / 2}Z`;
}

/**
 * @param {Line} line
 * @returns {[number, number]} the middle of its longest part
 */
function middle(line) {
  let [best, length] = [/** @type {[number, number]} */ (line[0] ?? [0, 0]), -1];
  for (let index = 1; index < line.length; index++) {
    const [[fromX, fromY], [x, y]] = [line[index - 1], line[index]];
    const found = Math.hypot(x - fromX, y - fromY);
    if (found > length) [best, length] = [[(fromX + x) / 2, (fromY + y) / 2], found];
  }
  return best;
}
