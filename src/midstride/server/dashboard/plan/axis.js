/**
 * Bars on one axis of time: the steps of plans, what falls meanwhile, and what subscribers did without.
 *
 * @module
 */

import { s } from "../dom.js";
import { scale, tickLabel, ticks, tickStep } from "../timeline/scale.js";
import { measuredSpans, plannedSpans, stretches } from "./schedule.js";
import { duration, stepText } from "./words.js";

/**
 * @typedef {{begin: number, end: number, kind: string, text?: string, words: string}} Bar `kind` is its look
 * @typedef {{label: string, heading?: boolean, bars: Bar[]}} AxisRow a heading's label is over the whole width
 */

const ROW = 20;
const BAR = 12;
const FOOT = 20;
const CHARACTER = 6.6;

/**
 * @param {AxisRow[]} rows
 * @param {{width: number, span: number, labels?: number, title: string}} options `labels`: the width of their column
 * @returns {SVGElement}
 */
export function axis(rows, { width, span, labels = 26, title }) {
  const height = rows.length * ROW + FOOT;
  const time = scale(0, Math.max(span, 1e-6), labels, width - 14);
  const most = Math.max(2, Math.floor((width - labels) / 64));
  const step = tickStep(time.to, most);
  const svg = s("svg", { class: "axis", viewBox: `0 0 ${width} ${height}`, width, height, role: "img", "aria-label": title });
  for (const at of ticks(0, time.to, most)) {
    const x = time.x(at);
    svg.append(s("line", { class: "axis-line", x1: x, x2: x, y1: 0, y2: height - FOOT }));
    svg.append(s("text", { class: "axis-tick", x: x > width - 34 ? Math.min(x + 14, width) : x, y: height - 5, "text-anchor": at === 0 ? "start" : x > width - 34 ? "end" : "middle" }, tickLabel(at, step)));
  }
  rows.forEach((row, index) => svg.append(drawRow(row, index * ROW, time, width, labels)));
  return svg;
}

/**
 * @param {AxisRow} row
 * @param {number} y
 * @param {import("../timeline/scale.js").Scale} time
 * @param {number} width
 * @param {number} labels
 */
function drawRow(row, y, time, width, labels) {
  const group = s("g", { class: "axis-row" });
  const middle = y + ROW / 2;
  if (row.heading) {
    const room = Math.floor(width / CHARACTER);
    group.append(s("text", { class: "axis-heading", x: 0, y: middle + 4 }, shortened(row.label, room), s("title", {}, row.label)));
    return group;
  }
  const room = Math.floor((labels - 4) / CHARACTER);
  group.append(s("text", { class: "axis-label", x: labels - 6, y: middle + 4, "text-anchor": "end" }, shortened(row.label, room)));
  for (const bar of row.bars) {
    const x = time.x(bar.begin);
    const w = Math.max(time.x(bar.end) - x, 2);
    const shape = s("rect", { class: "bar", "data-kind": bar.kind, x, y: middle - BAR / 2, width: w, height: BAR, rx: 2 });
    shape.append(s("title", {}, bar.words));
    group.append(shape);
    if (!bar.text) continue;
    const length = bar.text.length * CHARACTER;
    const inside = w > length + 6;
    const right = x + w + 4 + length < width;
    const at = inside ? x + w / 2 : right ? x + w + 4 : x - 4;
    const anchor = inside ? "middle" : right ? "start" : "end";
    const attributes = { class: inside ? "bar-text inside" : "bar-text", "data-kind": bar.kind, x: at, y: middle + 4, "text-anchor": anchor };
    group.append(s("text", attributes, bar.text));
  }
  return group;
}

/** @param {string} text @param {number} room in characters */
export function shortened(text, room) {
  return text.length <= room ? text : `${text.slice(0, Math.max(room - 1, 1))}…`;
}

/**
 * The steps of a plan as bars.
 *
 * @param {import("../store.js").Plan} plan
 * @param {import("./schedule.js").Span[]} [spans] as they are carried out; without, as planned
 * @returns {AxisRow[]}
 */
export function stepRows(plan, spans = plannedSpans(plan)) {
  return spans.map((span, index) => {
    const step = plan.steps[index];
    const end = span.end ?? span.begin + step.seconds;
    const words = `step ${index + 1}: ${stepText(step)}, ${duration(end - span.begin)}`;
    return { label: String(index + 1), bars: [{ begin: span.begin, end, kind: `${span.state} ${step.action}`, text: duration(end - span.begin), words }] };
  });
}

/** @param {import("../store.js").Plan} plan @returns {AxisRow[]} a heading and bars for each functionality that falls, as planned */
export function fallRows(plan) {
  const found = stretches(plan);
  return [...new Set(found.map((each) => each.functionality))].flatMap((name) => [
    { label: name, heading: true, bars: [] },
    { label: "", bars: found.filter((each) => each.functionality === name).flatMap(fallBars) },
  ]);
}

/** @param {import("./schedule.js").Stretch} stretch @returns {Bar[]} */
function fallBars(stretch) {
  const { functionality, begin, end, unserved } = stretch;
  const bar = (/** @type {string} */ kind, /** @type {number} */ from, /** @type {number} */ to, /** @type {string} */ what) => ({
    begin: from,
    end: to,
    kind,
    text: `${what} ${duration(to - from)}`,
    words: `${functionality} is ${what} for ${duration(to - from)}`,
  });
  if (unserved === null) return [bar("degraded", begin, end, "degraded")];
  const gone = bar("gone", unserved, end, "unserved");
  return unserved > begin ? [bar("degraded", begin, unserved, "degraded"), gone] : [gone];
}

/**
 * What each subscriber did without: its longest silence, beside the period that is its due.
 *
 * @param {Api.SwapReport[]} swaps
 * @returns {AxisRow[]}
 */
export function gapRows(swaps) {
  return swaps.flatMap((swap) => {
    const heading = (/** @type {string} */ text) => ({ label: `${text}: ${swap.topic} → ${swap.subscriber}`, heading: true, bars: [] });
    if (swap.gap === null) return [heading("unknown")];
    const period = swap.period ?? swap.gap;
    const due = Math.min(period, swap.gap);
    const words = `longest silence ${duration(swap.gap)}, of a period of ${duration(swap.period)}`;
    const periods = swap.gap_periods === null ? "" : ` = ${swap.gap_periods.toFixed(2)} periods`;
    /** @type {Bar[]} */ const bars = [{ begin: 0, end: due, kind: "normal", words }];
    if (swap.gap > due) bars.push({ begin: due, end: swap.gap, kind: "degraded", words });
    return [heading(`${duration(swap.gap)}${periods}`), { label: "", bars }];
  });
}

/** @param {Api.SwapReport[]} swaps @returns {number} what the axis of `gapRows` has to reach to (s) */
export function gapSpan(swaps) {
  return Math.max(...swaps.flatMap((swap) => [swap.gap ?? 0, (swap.period ?? 0) * 1.5]), 0.01);
}

/** @param {import("../store.js").Plan} plan @param {Api.Outcome} outcome @returns {AxisRow[]} the steps as measured */
export function measuredRows(plan, outcome) {
  return stepRows(plan, measuredSpans(plan, outcome));
}

/** @param {AxisRow[]} rows @returns {number} when the last bar ends */
export function spanOf(rows) {
  return Math.max(0, ...rows.flatMap((row) => row.bars.map((bar) => bar.end)));
}
