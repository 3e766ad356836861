/**
 * Pan and zoom: by dragging, wheel, two fingers, and buttons. Until the user moves it, the whole picture is fitted in.
 *
 * @module
 */

import { set } from "../dom.js";

const SMALLEST = 0.05;
const LARGEST = 4;
const MARGIN = 24;
const TOOLS = 44; // the buttons at the bottom
/** Below the first scale, the small text cannot be read and is left out; below the second one, any text. */
const FAR = 0.42;
const FARTHER = 0.2;

/** @typedef {"all" | "names" | "shapes"} Detail how much of the shapes is drawn */

export class Viewport {
  #svg;
  #world;
  #x = 0;
  #y = 0;
  #scale = 1;
  #moved = false;
  #content = { width: 1, height: 1 };
  /** @type {Map<number, {x: number, y: number}>} */ #pointers = new Map();
  #travelled = 0;
  /** @type {Detail} */ #detail = "all";
  /** Called when `detail` has changed. */
  onDetail = () => {};
  /** The largest scale at which a small picture is fitted in. */
  fitLargest = 1.5;

  /**
   * @param {SVGElement} svg
   * @param {SVGElement} world
   */
  constructor(svg, world) {
    this.#svg = svg;
    this.#world = world;
    svg.addEventListener("wheel", (event) => this.#onWheel(event), { passive: false });
    svg.addEventListener("pointerdown", (event) => this.#onDown(event));
    svg.addEventListener("pointermove", (event) => this.#onMove(event));
    for (const name of /** @type {const} */ (["pointerup", "pointercancel"])) {
      svg.addEventListener(name, (event) => void this.#pointers.delete(event.pointerId));
    }
    new ResizeObserver(() => this.#moved || this.fit()).observe(svg);
  }

  /** Whether the pointer has just dragged the picture, so that its release is no click. */
  get dragged() {
    return this.#travelled > 5;
  }

  get detail() {
    return this.#detail;
  }

  /** @param {{width: number, height: number}} content */
  show(content) {
    this.#content = content;
    if (!this.#moved) this.fit();
  }

  /** Shows everything, and goes on doing so until the user moves it. */
  fit() {
    const { width, height } = this.#svg.getBoundingClientRect();
    if (width === 0 || height === 0) return;
    const room = { width: width - 2 * MARGIN, height: height - 2 * MARGIN - TOOLS };
    const fitting = Math.min(room.width / this.#content.width, room.height / this.#content.height, this.fitLargest);
    this.#moved = false;
    this.#scale = Math.max(SMALLEST, fitting);
    this.#x = (width - this.#content.width * this.#scale) / 2;
    this.#y = (height - TOOLS - this.#content.height * this.#scale) / 2;
    this.#apply();
  }

  /** @param {number} factor */
  zoom(factor) {
    const { width, height } = this.#svg.getBoundingClientRect();
    this.#zoomAt(width / 2, height / 2, factor);
  }

  /**
   * Moves as little as needed to have a box in view, and makes it large enough to read.
   *
   * @param {{x: number, y: number, width: number, height: number}} box
   */
  reveal(box) {
    const { width, height } = this.#svg.getBoundingClientRect();
    if (this.#scale < FAR) this.#scale = Math.max(this.#scale, Math.min(1, width / (box.width * 1.2)));
    const left = this.#x + box.x * this.#scale;
    const top = this.#y + box.y * this.#scale;
    const right = left + box.width * this.#scale;
    const bottom = top + box.height * this.#scale;
    const shift = (/** @type {number} */ from, /** @type {number} */ to, /** @type {number} */ room) =>
      from < MARGIN ? MARGIN - from : to > room - MARGIN ? Math.max(room - MARGIN - to, MARGIN - from) : 0;
    const [dx, dy] = [shift(left, right, width), shift(top, bottom, height)];
    if (dx === 0 && dy === 0) return;
    this.#moved = true;
    this.#x += dx;
    this.#y += dy;
    this.#apply();
  }

  #apply() {
    set(this.#world, "transform", `translate(${this.#x.toFixed(2)} ${this.#y.toFixed(2)}) scale(${this.#scale.toFixed(4)})`);
    const detail = this.#scale < FARTHER ? "shapes" : this.#scale < FAR ? "names" : "all";
    if (detail !== this.#detail) this.#set(detail);
  }

  /** @param {Detail} detail */
  #set(detail) {
    this.#detail = detail;
    this.#svg.setAttribute("data-detail", detail);
    this.onDetail();
  }

  /**
   * What `take` returns while all of the shapes is drawn.
   *
   * @template T
   * @param {() => T} take
   * @returns {T}
   */
  inFull(take) {
    const detail = this.#detail;
    if (detail !== "all") this.#set("all");
    const result = take();
    if (detail !== "all") this.#set(detail);
    return result;
  }

  /**
   * @param {number} x in pixels of the SVG element
   * @param {number} y
   * @param {number} factor
   */
  #zoomAt(x, y, factor) {
    const scale = Math.min(LARGEST, Math.max(SMALLEST, this.#scale * factor));
    this.#x = x - ((x - this.#x) * scale) / this.#scale;
    this.#y = y - ((y - this.#y) * scale) / this.#scale;
    this.#scale = scale;
    this.#moved = true;
    this.#apply();
  }

  /** @param {WheelEvent} event */
  #onWheel(event) {
    event.preventDefault();
    const box = this.#svg.getBoundingClientRect();
    const lines = event.deltaMode === 1 ? 16 : 1;
    this.#zoomAt(event.clientX - box.left, event.clientY - box.top, Math.exp((-event.deltaY * lines) / 400));
  }

  /** @param {PointerEvent} event */
  #onDown(event) {
    if (event.button !== 0) return;
    if (this.#pointers.size === 0) this.#travelled = 0;
    this.#pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  }

  /** @param {PointerEvent} event */
  #onMove(event) {
    const before = this.#pointers.get(event.pointerId);
    if (before === undefined) return;
    const now = { x: event.clientX, y: event.clientY };
    this.#travelled += Math.hypot(now.x - before.x, now.y - before.y);
    if (!this.dragged && this.#pointers.size === 1) return; // a click with an unsteady hand
    this.#svg.setPointerCapture(event.pointerId);
    this.#pointers.set(event.pointerId, now);
    const [other] = [...this.#pointers].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
    if (other === undefined) {
      this.#x += now.x - before.x;
      this.#y += now.y - before.y;
      this.#moved = true;
      this.#apply();
      return;
    }
    const box = this.#svg.getBoundingClientRect();
    const factor = Math.hypot(now.x - other.x, now.y - other.y) / (Math.hypot(before.x - other.x, before.y - other.y) || 1);
    this.#zoomAt((now.x + other.x) / 2 - box.left, (now.y + other.y) / 2 - box.top, factor);
  }
}
