/**
 * The shape of a topic or service: its name, and the rate that is measured and the one that its contract guarantees.
 *
 * @module
 */

import { hz, s, set, setText } from "../dom.js";
import { stateOf } from "./component.js";
import { owner } from "./names.js";
import { short, topicSize } from "./measure.js";
import { isService } from "./services.js";

/**
 * @typedef {import("../store.js").Component} Component
 * @typedef {import("../store.js").Port} Port
 * @typedef {import("../store.js").View} View
 * @typedef {import("./structure.js").DrawnTopic} DrawnTopic
 */

export class TopicShape {
  /** @type {SVGElement} */ element;
  /** @type {SVGElement} */ #flag;
  /** @type {SVGElement} */ #figures;

  /** @param {DrawnTopic} drawn */
  constructor({ name, rate, kind }) {
    const { width, height } = topicSize(name, rate);
    this.name = name;
    this.rate = rate;
    this.kind = kind;
    this.#flag = s("text", { class: "flag", x: 7, y: height / 2 + 4 });
    this.#figures = s("text", { class: "figures-text", x: width / 2, y: 28, "text-anchor": "middle" });
    this.element = s(
      "g",
      { class: kind === "topic" ? "topic" : "topic service", role: "button", tabindex: "-1", "data-topic": name },
      s("rect", { class: "halo", x: -4, y: -4, width: width + 8, height: height + 8, rx: 15 }),
      s("rect", { class: "pill", width, height, rx: 11 }),
      s(
        "g",
        { class: "inside" },
        this.#flag,
        s("text", { x: width / 2, y: 15, "text-anchor": "middle" }, short(name)),
        rate === null ? null : this.#figures,
      ),
    );
  }

  /**
   * @param {View} view
   * @param {Map<string, Component>} components
   * @param {import("./viewport.js").Detail} detail figures are as they were while only shapes are drawn
   */
  update(view, components, detail) {
    const topic = view.topics[this.name];
    const satisfied = topic?.satisfied ?? true;
    const outside = topic?.outside ?? [];
    const ports = (topic?.publishers ?? []).map((ref) => published(components.get(owner(ref)), ref, this.name));
    const port = ports.find((each) => each !== undefined && each.gate !== "closed") ?? ports[0];
    const state = port === undefined ? "unknown" : stateOf(port);
    const rate = this.rate === null ? "" : ` / ${hz(this.rate)} Hz`;
    const measured = port === undefined || port.rate === null ? "–" : hz(port.rate);
    set(this.element, "data-satisfied", String(satisfied));
    set(this.element, "data-state", state);
    setText(this.#flag, satisfied ? (outside.length > 0 ? "⇥" : "") : "▲");
    if (detail !== "shapes") setText(this.#figures, state === "closed" ? "⊘ closed" : `${state === "low" ? "▼ " : ""}${measured}${rate}`);
    const words = [isService(this.name) ? this.name : `${this.kind} ${this.name}`];
    if (topic !== undefined) {
      words.push(topic.type, satisfied ? "contract satisfied" : "contract not satisfied");
      if (outside.length > 0) words.push(`also ${this.kind === "topic" ? "published" : "served"} from outside by ${outside.join(", ")}`);
    }
    set(this.element, "aria-label", words.join("; "));
  }
}

/**
 * @param {Component | undefined} component
 * @param {string} ref of the port, as "talker.out"
 * @param {string} topic
 * @returns {Port | undefined}
 */
function published(component, ref, topic) {
  const name = ref.slice(owner(ref).length + 1);
  return component?.ports.find((port) => port.name === name && port.topic === topic && port.direction === "out");
}
