/**
 * How large things are drawn, in the units of the graph (pixels at the scale 1).
 *
 * @module
 */

import { rowLabel } from "./services.js";

/**
 * @typedef {import("./structure.js").DrawnComponent} DrawnComponent
 * @typedef {{width: number, height: number}} Size
 * @typedef {Size & {left: number, inner: number, portsTop: number}} ComponentSize  `left`: where the box begins, after
 *   the figures of the inputs; `inner`: the box's width
 */

const FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "Noto Sans", "DejaVu Sans", sans-serif';
export const NAME = `600 13px ${FONT}`;
const SMALL = `11px ${FONT}`;

/** The space of a measured and a declared rate beside an input, and of an output's link to its topic. */
export const FIGURES = 90;
export const STUB = 10;
export const ROW = 17;
export const MODES_TOP = 40;
const NARROWEST = 118;
const LONGEST = 26; // characters of a name; the whole is in the title and the details

/** @type {CanvasRenderingContext2D | null} */ let canvas = null;
/** @type {Map<string, number>} */ const widths = new Map();

/**
 * @param {string} text
 * @param {string} font
 * @returns {number}
 */
function textWidth(text, font) {
  const key = `${font}\n${text}`;
  let width = widths.get(key);
  if (width === undefined) {
    canvas ??= document.createElement("canvas").getContext("2d");
    if (canvas === null) return text.length * 7;
    canvas.font = font;
    width = canvas.measureText(text).width;
    if (widths.size > 20_000) widths.clear();
    widths.set(key, width);
  }
  return width;
}

/**
 * @param {string} text
 * @param {number} [longest] in characters
 * @returns {string} with its middle left out if it is too long: beginnings and ends tell names apart
 */
export function short(text, longest = LONGEST) {
  const characters = [...text.replace(/[\s\p{C}]+/gu, " ")];
  if (characters.length <= longest) return characters.join("");
  const head = Math.ceil((longest - 1) / 2);
  return `${characters.slice(0, head).join("")}…${characters.slice(head + 1 - longest).join("")}`;
}

/**
 * @param {DrawnComponent} component
 * @returns {ComponentSize}
 */
export function componentSize({ entry, label, ins, outs }) {
  const widest = (/** @type {string[]} */ texts, /** @type {string} */ font) =>
    Math.max(0, ...texts.map((text) => textWidth(short(text), font)));
  const modes = entry.functionalities.map(
    ({ name, modes: all }) => 42 + textWidth(short(name), SMALL) + widest(all, `600 ${SMALL}`),
  );
  const labels = (/** @type {string[]} */ names) => names.map((name) => rowLabel(name, entry));
  const ports = widest(labels(ins), SMALL) + widest(labels(outs), SMALL) + 40;
  const inner = Math.ceil(
    Math.max(NARROWEST, 56 + textWidth(short(label), NAME), 24 + textWidth(short(entry.component), SMALL), ports, ...modes),
  );
  const portsTop = MODES_TOP + ROW * entry.functionalities.length + (entry.functionalities.length > 0 ? 8 : 2);
  const rows = Math.max(ins.length, outs.length);
  const left = ins.length > 0 ? FIGURES : 0;
  const width = left + inner + (outs.length > 0 ? STUB : 0);
  return { width, height: portsTop + ROW * rows + (rows > 0 ? 6 : 2), left, inner, portsTop };
}

/**
 * @param {string} name of a topic
 * @param {number | null} rate that its contract guarantees
 * @returns {Size}
 */
export function topicSize(name, rate) {
  const width = Math.max(textWidth(short(name), SMALL), rate === null ? 0 : 68);
  return { width: Math.ceil(width) + 28, height: rate === null ? 22 : 34 };
}

export const SQUARE = 15;
export const LISTED = 3;

/**
 * @param {string} title
 * @param {number} members
 * @returns {Size & {columns: number}} of a collapsed group
 */
export function groupSize(title, members) {
  const columns = Math.max(14, Math.min(24, Math.ceil(Math.sqrt(members * 2.6))));
  const width = Math.max(Math.ceil(textWidth(short(title, 40), NAME)) + 60, columns * SQUARE + 26, 250);
  const rows = Math.ceil(members / columns);
  return { width, height: 48 + rows * SQUARE + 10 + LISTED * 15 + 8, columns };
}
