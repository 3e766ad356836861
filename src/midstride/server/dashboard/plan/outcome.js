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
    rolled_back: `Rolled back in ${took}, every step undone`,
    failed: `Failed in ${took}`,
  }[/** @type {"done"} */ (outcome.outcome)];
  const worse = (outcome.remaining_degradations ?? []).some((each) => !each.planned);
  const kind = outcome.outcome === "done" ? (worse ? "warn" : "good") : "bad";
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
  const swaps = outcome.swaps ?? [];
  const fell = [
    ...Object.entries(outcome.below_baseline_seconds ?? {}).sort().map(([name, spent]) => `${name} was below its level for ${duration(spent)}.`),
    ...(outcome.remaining_degradations ?? []).map((each) => `Afterwards: ${lowered(each)}.`),
    ...(outcome.unexpected_exits?.length ? [`Exited unexpectedly meanwhile: ${outcome.unexpected_exits.join(", ")}; see \`midstride log\`.`] : []),
    ...(outcome.unexpected_degradations?.length
      ? [`Degraded unexpectedly meanwhile: ${outcome.unexpected_degradations.join(", ")}; see \`midstride why ${outcome.unexpected_degradations[0]}\`.`]
      : []),
    ...(outcome.fenced ?? []).map((each) => `Fenced: ${each.words}.`),
    ...(outcome.killed ?? []).map((each) => `${each.words}.`),
    ...(outcome.silences ?? []).map(silence),
    ...swaps.flatMap(faults),
  ];
  return [
    ...times(outcome, plan),
    ...(outcome.skews ?? []).map(skew),
    ...(fell.length ? fell : [nothingFell(swaps)]),
    ...(outcome.parameters ?? []).map((each) => each.words),
    ...Object.values(outcome.own_state ?? {}).map((words) => `${words}.`),
    ...Object.entries(outcome.late ?? {}).sort().map(
      ([name, spent]) => `The first slot of ${name} was ${duration(/** @type {number} */ (spent))} late; its state moved before.`,
    ),
  ];
}

/** @param {Api.DegradedFunctionality} each */
function lowered(each) {
  const words =
    each.to === null
      ? `no instance serves ${each.functionality}`
      : `${each.functionality} is in mode ${each.to} instead of ${each.from}`;
  return each.because ? `${words}: ${each.because.split("\n")[0]}` : words;
}

/** @param {Api.SilenceFault} fault */
function silence(fault) {
  return fault.seconds === null ? fault.words : `${fault.words} (for ${duration(fault.seconds)})`;
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

/** @param {Api.SwapReport} swap @returns {string[]} what was missed, lost or received twice at one subscriber */
function faults(swap) {
  const found = COUNTS.filter((name) => swap[name]).map(
    (name) => `${swap[name]} ${swap[name] === 1 ? name.replace(/s$/, "") : name}`,
  );
  return found.length ? [`Messages on ${swap.topic} at ${swap.subscriber}: ${listed(found)}.`] : [];
}

/** @param {Api.SwapReport[]} swaps */
function nothingFell(swaps) {
  const unknown = swaps.flatMap((swap) => {
    const names = COUNTS.filter((name) => swap[name] === null);
    return names.length ? [`${listed(names)} at ${swap.subscriber} on ${swap.topic}`] : [];
  });
  if (!unknown.length) return "Nothing fell below its level.";
  return `Nothing is known to have fallen below its level. Not known: ${unknown.join("; ")}.`;
}

/** The figures of one subscriber, in the order of the table's columns. @param {Api.SwapReport} swap @returns {string[]} */
export function figures(swap) {
  const periods = swap.gap_periods === null ? "unknown" : swap.gap_periods.toFixed(2);
  return [duration(swap.gap), periods, ...COUNTS.map((name) => (swap[name] === null ? "unknown" : String(swap[name])))];
}
