/**
 * Parts of the panel: a command to be copied, a plan's steps, its words.
 *
 * @module
 */

import { h, plural } from "../dom.js";
import { axis, fallRows, gapRows, gapSpan, spanOf, stepRows } from "../plan/axis.js";
import { details, figures, headline } from "../plan/outcome.js";
import { about, afterwards, cost, duration, falls, permission, remarks, stepText } from "../plan/words.js";

/** @param {string} text @param {typeof import("../say.js").say} say */
export function command(text, say) {
  const copy = () =>
    navigator.clipboard
      .writeText(text)
      .then(() => say("Copied."))
      .catch(() => say("The browser does not allow copying here; select the command instead.", { kind: "bad" }));
  return h(
    "p",
    { class: "command" },
    h("code", { class: "mono" }, text),
    h("button", { class: "button quiet", type: "button", onclick: copy, "aria-label": `Copy ${text}` }, "Copy"),
  );
}

/** @param {import("../store.js").Plan} plan @returns {HTMLElement} what a plan degrades, or that it degrades nothing */
export function summary(plan) {
  const found = falls(plan);
  const { worse, better } = afterwards(plan);
  if (!plan.steps.length) return h("p", { class: "banner" }, "Nothing to do: the system already matches the target.");
  const { continuity } = plan;
  const kept = continuity?.verdict === "kept";
  const shown = [...(plan.degradations ?? []), ...(plan.level_shifts ?? [])].map((each) => each.functionality);
  const besides = continuity?.verdict === "lost" ? continuity.found.filter((each) => !shown.includes(each.subject)) : [];
  return h(
    "div",
    { class: "banner falls", "data-kind": kept ? "good" : "warn" },
    continuity && continuity.verdict !== "lost" ? h("p", {}, `${kept ? "✓ " : ""}${continuity.headline}`) : null,
    ...found.map((fall) =>
      h("div", { class: "fall" }, h("p", {}, h("strong", {}, fall.already ? "Degraded already: " : "↓ Degrades: "), fall.head), ...fall.because.map((each) => h("p", { class: "because" }, each))),
    ),
    ...besides.map((each) =>
      h("p", {}, h("strong", {}, each.verdict === "lost" ? "Lost: " : "Not measurable here: "), `${each.words}.`),
    ),
    ...worse.map((each) => h("p", {}, h("strong", {}, "Afterwards: "), `${each}.`)),
    ...better.map((each) => h("p", {}, h("strong", {}, "Improves: "), each)),
  );
}

/** Where a table of all figures does not fit (px). */
const NARROW = 500;
const COLUMNS = ["topic", "subscriber", "longest gap", "in periods", "missed", "lost", "duplicates"];
const GLYPHS = /** @type {Record<string, string>} */ ({ planned: "·", current: "▶", done: "✓", failed: "✕" });

/**
 * The steps of a plan as a list.
 *
 * @param {import("../store.js").Plan} plan
 * @param {import("../plan/schedule.js").Span[]} [spans] how far each of them is
 */
export function steps(plan, spans) {
  return h(
    "ol",
    { class: "rows steps" },
    ...plan.steps.map((step, index) => {
      const state = spans?.[index].state ?? "planned";
      const [verb, ...rest] = stepText(step).split(" ");
      const kind = step.action === "handover" ? "hand over" : verb;
      const what = step.action === "handover" ? rest.slice(1).join(" ") : rest.join(" ");
      return h(
        "li",
        { class: "row step", "data-state": state, "aria-current": state === "current" ? "step" : null },
        h("span", { class: "muted number step-number" }, spans ? `${GLYPHS[state]} ${index + 1}` : String(index + 1)),
        h("span", { class: "grow" }, h("strong", { class: "verb", "data-action": step.action }, kind), ` ${what}`, spans ? h("span", { class: "visually-hidden" }, ` (${state})`) : null),
        h("span", { class: "number muted" }, took(step, spans?.[index])),
      );
    }),
  );
}

/** How long a step took, or is to take. @param {import("../plan/words.js").Step} step @param {import("../plan/schedule.js").Span} [span] */
function took(step, span) {
  const measured = span && span.end !== null && ["done", "failed"].includes(span.state);
  return measured ? duration(/** @type {number} */ (span.end) - span.begin) : about(step);
}

/** Everything that the command line says of a plan. @param {import("../store.js").Plan} plan @param {number} width of the axis (px) */
export function planParts(plan, width) {
  if (!plan.steps.length) return [summary(plan)];
  return [
    ...permission(plan).map(({ kind, words }) => h("p", { class: "permission", "data-kind": kind || null }, words)),
    summary(plan),
    ...remarks(plan).map((each) => h("p", { class: "remark" }, each)),
    steps(plan),
    planAxis(plan, width),
    h("p", { class: "muted" }, cost(plan)),
  ];
}

/** @param {import("../store.js").Plan} plan @param {number} width @param {import("../plan/schedule.js").Span[]} [spans] */
export function planAxis(plan, width, spans) {
  const rows = [...stepRows(plan, spans), ...fallRows(plan)];
  return axis(rows, { width, span: spanOf(rows), title: `${plural(plan.steps.length, "step")} on a time axis` });
}

/** Everything that the command line says of an outcome. @param {Api.Outcome} outcome @param {import("../store.js").Plan | null} plan @param {number} width */
export function outcomeParts(outcome, plan, width) {
  const { kind, words } = headline(outcome);
  return [
    h("p", { class: "banner outcome", "data-kind": kind }, words),
    h("ul", { class: "outcome-details" }, ...details(outcome, plan).map((each) => h("li", {}, each))),
    verdict(outcome.verdict),
    ...gaps(outcome.swaps ?? [], width),
  ];
}

/** @param {Api.SwapReport} swap @returns {HTMLElement} */
function counts(swap) {
  const [, , missed, lost, duplicates] = figures(swap);
  return h("p", { class: "counts" }, `${swap.subscriber}: missed ${missed}, lost ${lost}, duplicates ${duplicates}`);
}

/** @param {Api.Verdict | undefined} found what Alloy found, where it was asked */
function verdict(found) {
  if (!found) return null;
  const because = found.because ? `: ${found.because}` : "";
  return h("p", {}, `${found.subject} ${String(found.verdict).toUpperCase()}${because} (${found.by}, ${found.scope})`);
}

/** @param {Api.SwapReport[]} swaps @param {number} width @returns {(Node | null | false)[]} each subscriber's gap and figures */
export function gaps(swaps, width) {
  if (!swaps.length) return [];
  const narrow = width < NARROW;
  return [
    h("h3", { class: "panel-title" }, "Longest silence at each subscriber"),
    axis(gapRows(swaps), { width, span: gapSpan(swaps), labels: 4, title: "Longest silence at each subscriber" }),
    ...(narrow ? swaps.map(counts) : []),
    !narrow && h(
      "div",
      { class: "table-wrap", tabindex: 0, role: "region", "aria-label": "Figures of each subscriber" },
      h(
        "table",
        { class: "figures" },
        h("thead", {}, h("tr", {}, ...COLUMNS.map((each, index) => h("th", { scope: "col", class: index < 2 ? null : "number" }, each)))),
        h("tbody", {}, ...swaps.map((swap) => h("tr", {}, h("td", {}, swap.topic), h("td", {}, swap.subscriber), ...figures(swap).map((each) => h("td", { class: "number" }, each))))),
      ),
    ),
  ];
}
