/**
 * How a change ended, in the words of the command line (cli/render.py), and its figures.
 *
 * @module
 */

import { aboutPlan, duration, listed } from "./words.js";

const COUNTS = /** @type {const} */ (["missed", "lost", "duplicates"]);

/** @param {Api.Outcome} outcome @returns {{kind: "good" | "warn" | "bad", words: string}} */
export function headline(outcome) {
  const took = duration(outcome.seconds);
  const words = {
    done: `Done in ${took}`,
    refused: "Refused, nothing was changed",
    incomplete: `In part, in ${took}`,
    rolled_back: `Rolled back in ${took}, every step undone`,
    failed: `Failed in ${took}`,
  }[/** @type {"done"} */ (outcome.outcome)];
  const kept = !outcome.continuity || outcome.continuity.verdict === "kept";
  const kind = outcome.outcome === "done" ? (kept ? "good" : "warn") : "bad";
  return { kind, words: outcome.because ? `${words}: ${outcome.because}` : `${words}.` };
}

/**
 * What happened besides, one sentence a line.
 *
 * @param {Api.Outcome} outcome
 * @param {import("../store.js").Plan | null} plan null where none is known
 * @returns {string[]}
 */
export function details(outcome, plan) {
  if (outcome.outcome === "refused") return [];
  return [
    ...times(outcome, plan),
    ...(outcome.skews ?? []).map(skew),
    ...continuity(outcome.continuity ?? null),
    ...(outcome.parameters ?? []).map((each) => each.words),
    ...Object.values(outcome.own_state ?? {}).map((words) => `${words}.`),
    ...Object.entries(outcome.late ?? {}).sort().map(
      ([name, spent]) => `The first slot of ${name} was ${duration(/** @type {number} */ (spent))} late; its state moved before.`,
    ),
  ];
}

/** @param {Api.Assessments | null} found null: recorded by an earlier version @returns {string[]} */
function continuity(found) {
  if (!found) return [];
  if (found.verdict !== "lost") return [found.headline];
  return found.found.map((each) => `${each.verdict === "lost" ? "" : "Not measurable here: "}${each.words}.`);
}

/** @param {Api.ModeSkew} skew */
function skew(skew) {
  const kind = skew.kind[0].toUpperCase() + skew.kind.slice(1);
  return `${kind} of ${listed(skew.functionalities)}: within ${(skew.seconds * 1000).toFixed(1)} ms.`;
}

/**
 * The planned duration beside the measured one. A plan that is verified is carried out without overlap.
 *
 * @param {Api.Outcome} outcome
 * @param {import("../store.js").Plan | null} plan
 */
function times(outcome, plan) {
  if (outcome.outcome !== "done" || !plan || !outcome.steps?.length || outcome.verdict) return [];
  const ended = Math.max(...outcome.steps.map((each) => each.began + each.seconds));
  const together = outcome.steps.reduce((sum, each) => sum + each.seconds, 0);
  const inAll = duration(ended) === duration(together) ? "" : `, for steps of ${duration(together)} in all`;
  return [`Planned: ${aboutPlan(plan)}. Measured: ${duration(ended)}${inAll}.`];
}

/** The figures of one subscriber, in the order of the table's columns. @param {Api.SwapReport} swap @returns {string[]} */
export function figures(swap) {
  const periods = swap.gap_periods === null ? "unknown" : swap.gap_periods.toFixed(2);
  return [duration(swap.gap), periods, ...COUNTS.map((name) => (swap[name] === null ? "unknown" : String(swap[name])))];
}
