/**
 * A report as one file: a change of the history with its graph, plan, timeline and figures; or plans before it.
 *
 * It is opened from disk: its data is in the page, and nothing is fetched.
 *
 * @module
 */

import { comparison } from "../change/compare.js";
import { gaps, outcomeParts, planParts, steps } from "../change/parts.js";
import { h, plural, replace } from "../dom.js";
import { axis, fallRows, measuredRows, spanOf } from "../plan/axis.js";
import { headline } from "../plan/outcome.js";
import { measuredSpans } from "../plan/schedule.js";
import { duration } from "../plan/words.js";
import { byName } from "../store.js";
import { reportGraph } from "./graph.js";
import { reportTimeline } from "./timeline.js";

/**
 * @typedef {import("../store.js").Plan} Plan
 * @typedef {Omit<Api.ReportDocument, "change" | "plans"> & {change: Api.ChangeReport | null,
 *   plans: import("../change/compare.js").Plans | null}} Data
 */

/** @param {number} at unix seconds @returns {string} the local date and time */
function date(at) {
  return new Date(at * 1000).toLocaleString(undefined, { dateStyle: "medium", timeStyle: "medium" });
}

/** @param {string} title @param {...import("../dom.js").Child} children */
function section(title, ...children) {
  return h("section", { class: "report-part" }, h("h2", {}, title), ...children);
}

/** @param {Data} data the document in the file */
function report(data) {
  const root = /** @type {HTMLElement} */ (document.getElementById("report"));
  const width = Math.min(Math.max(document.documentElement.clientWidth - 64, 320), 1200);
  const views = { before: data.before && byName(data.before), after: data.after && byName(data.after) };
  const found = data.change;
  const plans = data.plans ?? (found?.plan ? { [found.plan.strategy]: found.plan } : {});
  const made = Object.values(plans).filter((plan) => !plan.refused);
  const plan = made.length === 1 || found ? made[0] : null;
  replace(root, head(data, plan));
  const timeline = found?.timeline ? section("What happened") : null;
  if (views.before) {
    const graph = h("section", { class: "report-part report-graph" });
    root.append(graph);
    const drawn = reportGraph(graph, { before: views.before, after: views.after }, made[0] ?? null, found?.timeline ?? null);
    if (timeline && found?.timeline) timeline.append(reportTimeline({ ...found, timeline: found.timeline }, views.before, drawn));
  } else if (timeline) timeline.append(h("p", { class: "muted" }, "The plan was not recorded, so there is no graph."));
  if (timeline) root.append(timeline);
  const required = data.required.map((words) => h("p", { class: "permission" }, `Required when it is carried out: ${words}.`));
  if (found) root.append(...changeParts(found, plan, width));
  if (!found && plan) root.append(section("Plan", ...required, ...planParts(plan, width)));
  if (!found && !plan) root.append(section("Strategies", ...required, ...comparison(plans, width, null)), ...made.map((each) => section(`Plan: ${each.strategy}`, ...planParts(each, width))));
  for (const [name, refused] of Object.entries(plans).filter(([, each]) => each.refused)) {
    root.append(section(`${name} is refused`, h("p", { class: "refusal banner", "data-kind": "bad" }, refused.refused)));
  }
  root.append(specifications(found, made[0]), foot(data));
}

/** @param {Data} data @param {Plan | null} plan */
function head(data, plan) {
  const found = data.change;
  const outcome = found?.outcome ? headline(found.outcome) : null;
  const line = found
    ? [`change ${found.change.number} of ${data.system}`, date(found.change.at), `strategy ${plan?.strategy ?? "unknown"}`, data.backend]
    : [`plan for ${data.system}`, "nothing was changed", date(data.written)];
  const ended = found && !outcome ? (found.change.outcome ?? "no outcome recorded").replace("_", " ") : null;
  return h(
    "header",
    { class: "report-head" },
    h("h1", {}, data.title),
    h("p", { class: "muted" }, line.filter(Boolean).join(" · ")),
    found && found.change.by && found.change.by !== found.change.command ? h("p", { class: "muted" }, `command: ${found.change.command}`) : null,
    outcome && h("p", { class: "banner", "data-kind": outcome.kind }, outcome.words),
    found && ended && h("p", { class: "banner", "data-kind": "warn" }, `${ended}${found.change.because ? `: ${found.change.because}` : ""}`),
  );
}

/** @param {Api.ChangeReport} found @param {Plan | null} plan @param {number} width */
function changeParts(found, plan, width) {
  const parts = [];
  if (found.outcome) {
    parts.push(section("Outcome", ...outcomeParts(found.outcome, plan, width)));
    if (plan) {
      const rows = [...measuredRows(plan, found.outcome)];
      const drawn = axis(rows, { width, span: spanOf(rows), title: "The steps as measured" });
      parts.push(section("Steps, as measured", steps(plan, measuredSpans(plan, found.outcome)), drawn));
    }
  } else parts.push(section("Outcome", h("p", {}, "How the change went was not recorded beyond its steps."), ...gaps(found.change.swaps, width)));
  parts.push(plan ? section("Plan, as shown before", ...planParts(plan, width)) : section("Plan", h("p", {}, "The plan was not recorded.")));
  parts.push(section("Steps in the journal", journal(found.change)));
  const events = found.timeline?.events ?? [];
  parts.push(section("Events", events.length ? eventList(events) : h("p", { class: "muted" }, "No events were recorded.")));
  if (found.incidents.length) parts.push(section("Incidents", eventList(found.incidents)));
  return parts;
}

/** @param {Api.ChangeRecord} change */
function journal(change) {
  const done = change.steps.filter((each) => each.outcome === "done").length;
  return h(
    "div",
    {},
    h("p", {}, `${done} of ${plural(change.total, "step")} done; the specification is at version ${change.version} afterwards.`),
    h(
      "ol",
      { class: "rows" },
      ...change.steps.map((each) =>
        h("li", { class: "row" }, h("span", { class: "grow" }, each.words), h("span", { class: "muted" }, (each.outcome ?? "not ended").replace("_", " ")), h("span", { class: "number" }, duration(each.seconds))),
      ),
    ),
  );
}

/** @param {{at: number, words: string}[]} events */
function eventList(events) {
  const milliseconds = (/** @type {number} */ at) => {
    const time = new Date(at * 1000);
    return `${time.toTimeString().slice(0, 8)}.${String(time.getMilliseconds()).padStart(3, "0")}`;
  };
  return h("ol", { class: "event-list" }, ...events.map((each) => h("li", {}, h("time", {}, milliseconds(each.at)), h("span", { class: "words" }, each.words))));
}

/** @param {Api.ChangeReport | null} found @param {Plan | undefined} plan */
function specifications(found, plan) {
  const before = found ? found.before : plan?.start;
  const after = found ? found.after : plan?.target;
  const one = (/** @type {string} */ title, /** @type {Api.SpecificationForm | null | undefined} */ form) =>
    form ? h("details", {}, h("summary", {}, title), h("pre", { class: "mono" }, JSON.stringify(form, null, 2))) : h("p", { class: "muted" }, `${title}: not recorded.`);
  return section("Specifications", one("Before, as JSON", before), one("After, as JSON", after));
}

/** @param {Data} data */
function foot(data) {
  const words = `Written by Midstride ${data.midstride}, ${date(data.written)}. All of its data is in this file, as JSON in the element "data".`;
  return h("footer", { class: "muted" }, words);
}

/** Light or dark, as the reader's system is; the page itself lets the user choose. */
function theme() {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const apply = () => document.documentElement.setAttribute("data-theme", dark.matches ? "dark" : "light");
  dark.addEventListener("change", apply);
  apply();
}

theme();
report(JSON.parse(/** @type {HTMLElement} */ (document.getElementById("data")).textContent ?? "null"));
