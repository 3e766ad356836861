/**
 * Writes what has changed into the shapes. Of many changes, each frame writes some: the browser has to draw them as well.
 *
 * @module
 */

import { ComponentShape } from "./component.js";
import { signature } from "./entries.js";
import { CollapsedGroup } from "./group.js";
import { TopicShape } from "./topic.js";

/**
 * @typedef {import("../store.js").Component} Component
 * @typedef {import("../store.js").View} View
 * @typedef {import("./viewport.js").Detail} Detail
 *
 * @typedef {{view: View | null, components: Map<string, Component>, drawn: Map<string, {shape: object}>,
 *   linksOf: Map<string, import("./link.js").LinkShape[]>, ghosts: import("./ghosts.js").Ghosts | null,
 *   detail: Detail}} Scene
 */

/** So many components a frame: 150 that change at once are shown within 70 ms, and no frame takes longer than the others. */
const PER_FRAME = 40;

export class Writer {
  #scene;
  /** @type {Map<string, Component>} */ #written = new Map(); // what the shapes show
  /** @type {Set<string>} */ #stale = new Set(); // components whose shapes do not show their entries yet
  /** @type {View["topics"] | null} */ #topics = null;
  #frame = 0;

  /** @param {() => Scene} scene as it is when it is asked for */
  constructor(scene) {
    this.#scene = scene;
  }

  /** @param {boolean} everything also where an entry is as before: shapes are new, or show more */
  update(everything) {
    const { view, components, drawn, detail } = this.#scene();
    if (view === null) return;
    const anew = everything || this.#topics !== view.topics;
    for (const { shape } of drawn.values()) {
      if (shape instanceof CollapsedGroup) shape.update(view, components, anew);
      else if (anew && shape instanceof TopicShape) shape.update(view, components, detail);
    }
    this.#topics = view.topics;
    if (everything) this.#written.clear();
    for (const [name, entry] of components) if (this.#written.get(name) !== entry) this.#stale.add(name);
    this.#write(everything ? Infinity : PER_FRAME);
  }

  /** @param {number} most components */
  #write(most) {
    cancelAnimationFrame(this.#frame);
    const { view, components, drawn, linksOf, ghosts, detail } = this.#scene();
    if (view === null) return;
    /** @type {Set<import("./link.js").LinkShape | TopicShape>} */ const near = new Set();
    let count = 0;
    for (const name of this.#stale) {
      if (count === most) break;
      this.#stale.delete(name);
      const entry = components.get(name);
      if (entry === undefined) continue;
      this.#written.set(name, entry);
      const shape = drawn.get(`c:${name}`)?.shape;
      if (shape instanceof ComponentShape && signature(entry) === signature(shape.drawn.entry)) {
        shape.update(entry, view, ghosts, detail);
        count += 1;
      }
      for (const link of linksOf.get(name) ?? []) near.add(link);
      for (const { direction, topic } of entry.ports) {
        const published = direction === "out" ? drawn.get(`t:${topic}`)?.shape : undefined;
        if (published instanceof TopicShape) near.add(published);
      }
    }
    for (const shape of near) {
      if (shape instanceof TopicShape) shape.update(view, components, detail);
      else shape.update(components, ghosts);
    }
    if (this.#stale.size > 0) this.#frame = requestAnimationFrame(() => this.#write(PER_FRAME));
  }
}
