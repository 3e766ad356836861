/**
 * A change in progress: its steps, on an axis of time as they are carried out, and the gaps once they are measured.
 *
 * @module
 */

import { h } from "../dom.js";
import { liveSpans } from "../plan/schedule.js";
import { gaps, planAxis, steps } from "./parts.js";

const STATES = /** @type {Record<string, string>} */ ({
  planning: "Planning",
  verifying: "Verifying with Alloy",
  executing: "Carrying out",
  rolling_back: "Rolling back",
  measuring: "Measuring at the subscribers, over 20 periods",
});

/** A change in progress, or one that has ended. @param {Api.ChangeView} change of the view @param {number} width of the axis (px) @returns {import("../dom.js").Child[]} */
export function watch(change, width) {
  const done = change.steps.filter((each) => each.ended !== null && !each.failed).length;
  const ended = change.state === "ended";
  const count = change.total === null ? "" : `, ${done} of ${change.total} steps done`;
  const good = change.outcome === "done" ? "good" : "bad";
  const kind = ended ? good : change.state === "rolling_back" ? "bad" : null;
  const words = ended ? `ended: ${change.because}` : `${STATES[change.state] ?? change.state}${count} …`;
  /** @type {import("../dom.js").Child[]} */ const parts = [
    h("h2", { class: "panel-title" }, change.command),
    h("p", { class: "banner", "data-kind": kind, role: "status" }, words),
  ];
  if (change.plan) {
    const spans = liveSpans({ ...change, plan: change.plan });
    parts.push(steps(change.plan, spans), planAxis(change.plan, width, spans));
  }
  return [...parts, ...gaps(change.swaps, width)];
}
