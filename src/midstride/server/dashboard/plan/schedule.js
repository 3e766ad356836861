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

/** @param {import("../store.js").Plan} plan @returns {number[]} when each step begins, one after another, and the end of the last */
export function begins(plan) {
  const found = [0];
  for (const step of plan.steps) found.push(/** @type {number} */ (found.at(-1)) + step.seconds);
  return found;
}

/** @param {import("../store.js").Plan} plan @returns {Span[]} as planned, one step after another */
export function plannedSpans(plan) {
  const at = begins(plan);
  return plan.steps.map((_, index) => ({
    begin: at[index],
    end: at[index + 1],
    state: "planned",
  }));
}

/**
 * What each step of a change in progress took so far.
 *
 * @param {Api.ChangeView & {plan: Api.PlanPreview}} change the view's `change`
 * @returns {Span[]} by step, as planned where a step has not begun
 */
export function liveSpans(change) {
  const { plan } = change;
  const spans = plannedSpans(plan);
  if (!change.steps.length) return spans;
  const first = Math.min(...change.steps.map((each) => each.began));
  let latest = 0;
  for (const each of change.steps) {
    const end = each.ended === null ? null : each.ended - first;
    const state = each.failed ? "failed" : end === null ? "current" : "done";
    spans[each.index] = { begin: each.began - first, end, state };
    latest = Math.max(latest, end ?? each.began - first + plan.steps[each.index].seconds);
  }
  const begun = new Set(change.steps.map((each) => each.index));
  spans.forEach((span, index) => {
    if (begun.has(index)) return;
    const seconds = plan.steps[index].seconds;
    spans[index] = { begin: latest, end: latest + seconds, state: "planned" };
    latest += seconds;
  });
  return spans;
}

/**
 * The steps of a change that has ended, as measured.
 *
 * @param {import("../store.js").Plan} plan
 * @param {Api.Outcome} outcome
 * @returns {Span[]}
 */
export function measuredSpans(plan, outcome) {
  const spans = plannedSpans(plan);
  const measured = new Map(outcome.steps.map((each) => /** @type {[number, Api.StepTime]} */ ([each.step - 1, each])));
  const last = Math.max(0, ...outcome.steps.map((each) => each.began + each.seconds));
  return spans.map((_, index) => {
    const found = measured.get(index);
    if (found === undefined) return { begin: last, end: last, state: "planned" };
    return { begin: found.began, end: found.began + found.seconds, state: "done" };
  });
}

/** @param {import("../store.js").Plan} plan @returns {Stretch[]} when functionalities are below their level, one step after another */
export function stretches(plan) {
  const at = begins(plan);
  const begin = (/** @type {number} */ step) => at[Math.max(step - 1, 0)];
  return (plan.degradations ?? []).map((fall) => ({
    functionality: fall.functionality,
    begin: begin(fall.from_step),
    end: at[fall.to_step ?? at.length - 1],
    unserved: fall.unserved_from_step === null ? null : begin(fall.unserved_from_step),
  }));
}
