/**
 * Plans and their execution on a time axis, as data: when each step begins and ends, when what is below its level.
 *
 * @module
 */

/**
 * @typedef {{begin: number, end: number | null, state: "planned" | "current" | "done" | "failed"}} Span in seconds from
 *   the beginning of the first step
 * @typedef {{functionality: string, begin: number, end: number, unserved: number | null}} Stretch
 */

/** @param {any} plan @returns {number[]} when each step begins, one after another, and the end of the last */
export function begins(plan) {
  const found = [0];
  for (const step of plan.steps) found.push(/** @type {number} */ (found.at(-1)) + step.seconds);
  return found;
}

/** @param {any} plan @returns {Span[]} as planned, one step after another */
export function plannedSpans(plan) {
  const at = begins(plan);
  return plan.steps.map((/** @type {any} */ _, /** @type {number} */ index) => ({
    begin: at[index],
    end: at[index + 1],
    state: "planned",
  }));
}

/**
 * What each step of a change in progress took so far.
 *
 * @param {any} change the view's `change`
 * @returns {Span[]} by step, as planned where a step has not begun
 */
export function liveSpans(change) {
  const spans = plannedSpans(change.plan);
  if (!change.steps.length) return spans;
  const first = Math.min(...change.steps.map((/** @type {any} */ each) => each.began));
  let latest = 0;
  for (const each of change.steps) {
    const end = each.ended === null ? null : each.ended - first;
    const state = each.failed ? "failed" : end === null ? "current" : "done";
    spans[each.index] = { begin: each.began - first, end, state };
    latest = Math.max(latest, end ?? each.began - first + change.plan.steps[each.index].seconds);
  }
  const begun = new Set(change.steps.map((/** @type {any} */ each) => each.index));
  spans.forEach((span, index) => {
    if (begun.has(index)) return;
    const seconds = change.plan.steps[index].seconds;
    spans[index] = { begin: latest, end: latest + seconds, state: "planned" };
    latest += seconds;
  });
  return spans;
}

/**
 * The steps of a change that has ended, as measured.
 *
 * @param {any} plan
 * @param {any} outcome
 * @returns {Span[]}
 */
export function measuredSpans(plan, outcome) {
  const spans = plannedSpans(plan);
  /** @type {Map<number, any>} */
  const measured = new Map(outcome.steps.map((/** @type {any} */ each) => [each.step - 1, each]));
  const last = Math.max(0, ...outcome.steps.map((/** @type {any} */ each) => each.began + each.seconds));
  return spans.map((_, index) => {
    const found = measured.get(index);
    if (found === undefined) return { begin: last, end: last, state: "planned" };
    return { begin: found.began, end: found.began + found.seconds, state: "done" };
  });
}

/** @param {any} plan @returns {Stretch[]} when functionalities are below their level, one step after another */
export function stretches(plan) {
  const at = begins(plan);
  const begin = (/** @type {number} */ step) => at[Math.max(step - 1, 0)];
  return (plan.degradations ?? []).map((/** @type {any} */ fall) => ({
    functionality: fall.functionality,
    begin: begin(fall.from_step),
    end: fall.to_step === null ? at.at(-1) : at[fall.to_step],
    unserved: fall.unserved_from_step === null ? null : begin(fall.unserved_from_step),
  }));
}
