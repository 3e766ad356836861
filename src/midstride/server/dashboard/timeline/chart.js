/**
 * The picture of the timeline: a row for each functionality, changes as lines through all of them, events above.
 *
 * @module
 */

import { clock, s } from "../dom.js";
import { shortened } from "../plan/axis.js";
import { duration } from "../plan/words.js";
import { marks } from "./intervals.js";
import { scale, tickLabel, ticks, tickStep } from "./scale.js";

/**
 * @typedef {import("./intervals.js").Row} Row
 * @typedef {import("./intervals.js").Segment} Segment
 * @typedef {{command: string, began: number, ended: number | null, outcome: string | null}} PastChange
 * @typedef {{rows: Row[], events: import("../store.js").Event[], changes: PastChange[], since: number, until: number,
 *   at: number | null, origin: number, live: boolean}} Picture `at`: the time that is shown, `origin`: the 0 of the labels
 * @typedef {{svg: SVGElement, at: (x: number) => number, x: (at: number) => number, height: number}} Chart
 */

export const ROW = 24;
const BAR = 17;
const HEAD = 22;
const FOOT = 24;
const CHARACTER = 6.6;
const SHADE = /** @type {Record<string, string>} */ ({ normal: "●", reduced: "◐", degraded: "○", gone: "✕" });

/** @param {number} width @returns {number} the width of the column of names */
function labelWidth(width) {
  return Math.round(Math.min(Math.max(width * 0.16, 90), 220));
}

/**
 * @param {Picture} picture
 * @param {number} width pixels
 * @param {(row: Row, segment: Segment) => void} [onPick] a lowered stretch was chosen
 * @returns {Chart}
 */
export function drawChart(picture, width, onPick) {
  const labels = labelWidth(width);
  const height = HEAD + picture.rows.length * ROW + FOOT;
  const time = scale(picture.since, picture.until, labels, width - 8);
  const svg = s("svg", { class: "chart", viewBox: `0 0 ${width} ${height}`, width, height, role: "group", "aria-label": "Modes over time" });
  svg.append(grid(picture, time, height, width - labels));
  picture.rows.forEach((row, index) => svg.append(drawRow(row, HEAD + index * ROW, time, labels, onPick)));
  picture.changes.forEach((change, index) => {
    const next = picture.changes[index + 1];
    svg.append(drawChange(change, time, height, next ? time.x(next.began) : width));
  });
  const head = s("g", { class: "marks" });
  for (const mark of marks(picture.events, picture.since, picture.until)) {
    const words = `${clock(mark.at)} ${mark.words}`;
    head.append(s("text", { class: "mark", "data-kind": mark.kind, x: time.x(mark.at), y: 15, "text-anchor": "middle" }, mark.glyph, s("title", {}, words)));
  }
  svg.append(head);
  if (picture.at !== null) svg.append(cursor(time.x(picture.at), height, clock(picture.at), width));
  return { svg, at: time.at, x: time.x, height };
}

/**
 * @param {Picture} picture
 * @param {import("./scale.js").Scale} time
 * @param {number} height
 * @param {number} width of the bars
 */
function grid(picture, time, height, width) {
  const most = Math.max(2, Math.floor(width / 110));
  const step = tickStep(picture.until - picture.since, most);
  const group = s("g", { class: "grid" });
  for (const at of ticks(picture.since, picture.until, most, picture.origin)) {
    const x = time.x(at);
    group.append(s("line", { class: "axis-line", x1: x, x2: x, y1: HEAD - 4, y2: height - FOOT + 2 }));
    const end = x > time.x(picture.until) - 14;
    const text = at === picture.origin && picture.live ? "now" : tickLabel(at - picture.origin, step);
    group.append(s("text", { class: "axis-tick", x, y: height - 7, "text-anchor": end ? "end" : "middle" }, text));
  }
  return group;
}

/**
 * @param {Row} row
 * @param {number} y
 * @param {import("./scale.js").Scale} time
 * @param {number} labels
 * @param {((row: Row, segment: Segment) => void) | undefined} onPick
 */
function drawRow(row, y, time, labels, onPick) {
  const middle = y + ROW / 2;
  const name = shortened(row.name, Math.floor((labels - 14) / CHARACTER));
  const group = s("g", { class: "timeline-row", "data-name": row.name });
  group.append(s("text", { class: "axis-label", x: labels - 8, y: middle + 4, "text-anchor": "end" }, name, s("title", {}, row.name)));
  for (const segment of row.segments) group.append(drawSegment(row, segment, middle, time, onPick));
  return group;
}

/**
 * A stretch in one mode: filled in the best one, outlined in a lower one, with its words where they fit.
 *
 * @param {Row} row
 * @param {Segment} segment
 * @param {number} middle
 * @param {import("./scale.js").Scale} time
 * @param {((row: Row, segment: Segment) => void) | undefined} onPick
 */
function drawSegment(row, segment, middle, time, onPick) {
  const { mode, because, reflex } = segment.interval;
  const x = time.x(segment.from);
  const width = Math.max(time.x(segment.to) - x - 1, 1.5);
  const whole = segment.interval.ended ?? segment.to;
  const lasted = duration(whole - segment.interval.began);
  const words = [`${row.name} in mode ${mode}${segment.open ? ` for ${lasted} so far` : ` for ${lasted}`}, from ${clock(segment.interval.began)}`];
  if (segment.kind !== "normal" && because) words.push(`${reflex ? "by its local reflex: " : ""}${because}`);
  const group = s("g", { class: "segment", "data-kind": segment.kind });
  group.append(s("rect", { class: "bar", "data-kind": segment.kind, x, y: middle - BAR / 2, width, height: BAR, rx: 2 }));
  group.append(s("title", {}, words.join("\n")));
  if (segment.kind === "normal") return group;
  const text = [`${SHADE[segment.kind]} ${mode} ${lasted}`, `${SHADE[segment.kind]} ${lasted}`, SHADE[segment.kind]].find((each) => each.length * CHARACTER + 4 < width);
  if (text) group.append(s("text", { class: "bar-text", "data-kind": segment.kind, x: x + width / 2, y: middle + 4, "text-anchor": "middle" }, text));
  if (onPick) {
    group.setAttribute("role", "button");
    group.setAttribute("tabindex", "0");
    group.setAttribute("aria-label", words.join(". "));
    const pick = () => onPick(row, segment);
    group.addEventListener("click", (event) => (event.stopPropagation(), pick()));
    group.addEventListener("keydown", (event) => {
      if (!["Enter", " "].includes(/** @type {KeyboardEvent} */ (event).key)) return;
      event.preventDefault();
      event.stopPropagation();
      pick();
    });
  }
  return group;
}

/**
 * @param {PastChange} change
 * @param {import("./scale.js").Scale} time
 * @param {number} height
 * @param {number} until where the room for its name ends
 */
function drawChange(change, time, height, until) {
  const from = time.x(change.began);
  const to = time.x(change.ended ?? time.to);
  const outcome = (change.outcome ?? "in progress").replace("_", " ");
  const group = s("g", { class: "past-change", "data-outcome": change.outcome ?? "running" });
  group.append(s("rect", { x: from, y: 2, width: Math.max(to - from, 1), height: height - FOOT }));
  group.append(s("line", { x1: from, x2: from, y1: 2, y2: height - FOOT + 2 }));
  const text = change.outcome === "done" ? change.command : `${change.command}: ${outcome}`;
  const room = Math.floor((until - from - 8) / CHARACTER);
  if (room >= 3) group.append(s("text", { x: from + 4, y: 13 }, shortened(text, room)));
  group.append(s("title", {}, `${clock(change.began)} ${change.command}: ${outcome}`));
  return group;
}

/** @param {number} x @param {number} height @param {string} words @param {number} width */
function cursor(x, height, words, width) {
  const near = x > width - 80;
  return s(
    "g",
    { class: "cursor" },
    s("line", { x1: x, x2: x, y1: 0, y2: height - FOOT + 6 }),
    s("path", { d: `M${x - 5},0h10l-5,7z` }),
    s("text", { x: near ? x - 6 : x + 6, y: height - 7, "text-anchor": near ? "end" : "start" }, words),
  );
}
