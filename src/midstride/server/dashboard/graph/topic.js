/**
 * The shape of a topic: its name and the rate that its contract guarantees.
 *
 * @module
 */

import { s, set, setText } from "../dom.js";
import { topicLabel, topicSize } from "./measure.js";

/**
 * @typedef {import("../store.js").View} View
 * @typedef {import("./structure.js").DrawnTopic} DrawnTopic
 */

export class TopicShape {
  /** @type {SVGElement} */ element;
  /** @type {SVGElement} */ #title = s("title");
  /** @type {SVGElement} */ #flag;

  /** @param {DrawnTopic} drawn */
  constructor({ name, rate }) {
    const label = topicLabel(name, rate);
    const { width, height } = topicSize(label);
    this.#flag = s("text", { class: "flag", x: 9, y: 16 });
    this.element = s(
      "g",
      { class: "topic", role: "button", tabindex: "-1", "data-topic": name },
      this.#title,
      s("rect", { class: "halo", x: -4, y: -4, width: width + 8, height: height + 8, rx: height / 2 + 4 }),
      s("rect", { class: "pill", width, height, rx: height / 2 }),
      this.#flag,
      s("text", { x: width / 2 + 4, y: 16, "text-anchor": "middle" }, label),
    );
    this.name = name;
  }

  /** @param {View} view */
  update(view) {
    const topic = view.topics[this.name];
    const satisfied = topic?.satisfied ?? true;
    const outside = topic?.outside ?? [];
    set(this.element, "data-satisfied", String(satisfied));
    setText(this.#flag, satisfied ? (outside.length > 0 ? "⇥" : "") : "▲");
    const words = [`topic ${this.name}`];
    if (topic !== undefined) {
      words.push(topic.type, satisfied ? "contract satisfied" : "contract not satisfied");
      if (outside.length > 0) words.push(`also published from outside by ${outside.join(", ")}`);
    }
    const text = words.join("; ");
    if (this.element.getAttribute("aria-label") === text) return;
    this.element.setAttribute("aria-label", text);
    this.#title.textContent = text;
  }
}
