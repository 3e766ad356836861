/**
 * Shapes move to where a new layout puts them, instead of jumping: the eye keeps hold of them.
 *
 * @module
 */

import { set } from "../dom.js";

/**
 * @typedef {import("./layout.js").Box} Box
 * @typedef {{element: SVGElement, from: Box | null, to: Box, resize: ((width: number, height: number) => void) | null}} Move
 */

const DURATION = 350; // in milliseconds
const MOST = 150; // more at once would stutter: they jump

export class Motion {
  #frame = 0;
  /** @type {() => void} */ #done = () => {};

  /**
   * @param {Move[]} moves
   * @param {() => void} done called once everything is in its place
   */
  start(moves, done) {
    this.finish();
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    const moving = moves.filter(({ from, to }) => from !== null && (from.x !== to.x || from.y !== to.y));
    for (const move of moves) if (!moving.includes(move)) put(move, 1);
    if (still || moving.length === 0 || moving.length > MOST) {
      for (const move of moving) put(move, 1);
      done();
      return;
    }
    this.#done = () => {
      for (const move of moving) put(move, 1);
      done();
    };
    const begun = performance.now();
    const step = (/** @type {number} */ now) => {
      const part = Math.min(1, Math.max(0, (now - begun) / DURATION));
      if (part === 1) {
        this.finish();
        return;
      }
      for (const move of moving) put(move, 1 - (1 - part) ** 3);
      this.#frame = requestAnimationFrame(step);
    };
    this.#frame = requestAnimationFrame(step);
  }

  /** Puts everything in its place at once. */
  finish() {
    cancelAnimationFrame(this.#frame);
    const done = this.#done;
    this.#done = () => {};
    done();
  }
}

/**
 * @param {Move} move
 * @param {number} part of the way, from 0 to 1
 */
function put({ element, from, to, resize }, part) {
  const between = (/** @type {number} */ start, /** @type {number} */ end) => start + (end - start) * part;
  const start = from ?? to;
  set(element, "transform", `translate(${between(start.x, to.x).toFixed(2)} ${between(start.y, to.y).toFixed(2)})`);
  resize?.(between(start.width, to.width), between(start.height, to.height));
}
