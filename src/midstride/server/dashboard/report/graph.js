/**
 * The graph of a report: before the change, with its plan, after it; or at a time in between.
 *
 * @module
 */

import { createGraph } from "../graph/graph.js";
import { h, plural, replace } from "../dom.js";
import { kindOf } from "../timeline/intervals.js";
import { falls } from "../plan/words.js";

/** Up to so many components, a lower picture is enough. */
const FEW = 6;

/**
 * @typedef {import("../store.js").View} View
 * @typedef {{graph: import("../graph/graph.js").Graph, at: (time: number | null) => void}} Drawn
 */

/**
 * The view at a time: as modelled before, in the modes that components reported.
 *
 * @param {View} view
 * @param {Api.ChangeTimeline} timeline of the change
 * @param {number} at unix seconds
 * @returns {View}
 */
function viewAt(view, timeline, at) {
  /** @type {View["instances"]} */ const components = Object.assign(Object.create(null), view.instances);
  for (const each of timeline.modes) {
    const component = components[each.instance];
    if (!component || each.began > at || (each.ended !== null && each.ended <= at)) continue;
    const functionalities = component.functionalities.map((known) =>
      known.name === each.functionality
        ? { ...known, mode: each.mode, normal: kindOf(each) === "normal", because: each.because, reflex: each.reflex }
        : known,
    );
    components[each.instance] = { ...component, functionalities };
  }
  return { ...view, instances: components, at };
}

/**
 * The step that was being carried out at a time, from 0; the number of steps once all are done.
 *
 * @param {Api.ChangeTimeline} timeline
 * @param {number} at
 * @returns {number | null}
 */
function stepAt(timeline, at) {
  const begun = timeline.events.filter((each) => each.kind === "step" && each.at <= at);
  const last = begun.at(-1);
  return last?.index ?? null;
}

/**
 * @param {HTMLElement} element
 * @param {{before: View, after: View | null}} views
 * @param {import("../store.js").Plan} plan
 * @param {Api.ChangeTimeline | null} timeline null where nothing happened yet
 * @returns {Drawn}
 */
export function reportGraph(element, views, plan, timeline) {
  const many = Object.keys(views.before.instances).length > FEW;
  const canvas = h("div", { class: many ? "report-canvas large" : "report-canvas" });
  const words = h("p", { class: "muted", role: "status" });
  const graph = createGraph(canvas, {});
  const buttons = h("div", { class: "change-actions", role: "group", "aria-label": "What the graph shows" });
  const show = (/** @type {string} */ what) => {
    const view = what === "after" && views.after ? views.after : views.before;
    graph.draw(view);
    graph.ghosts(what === "plan" ? plan : null);
    for (const each of buttons.querySelectorAll("button")) each.setAttribute("aria-pressed", String(each.dataset.what === what));
    const lowered = plan ? plural(falls(plan).length, "functionality") : "";
    replace(words, what === "plan" ? `The plan on the graph: + is created, − is removed; ${lowered} fall on the way.` : "");
  };
  for (const [what, title] of [["before", "Before"], ["plan", "With the plan"], ["after", "After"]]) {
    buttons.append(h("button", { class: "button", type: "button", "data-what": what, onclick: () => show(what) }, title));
  }
  element.append(h("h2", {}, "Graph"), buttons, canvas, words);
  show(plan?.steps?.length ? "plan" : "before");
  const at = (/** @type {number | null} */ time) => {
    if (time === null || timeline === null) return show("plan");
    for (const each of buttons.querySelectorAll("button")) each.setAttribute("aria-pressed", "false");
    graph.draw(viewAt(views.before, timeline, time));
    graph.ghosts(plan, { step: stepAt(timeline, time) });
    replace(words, `At ${(time - timeline.since).toFixed(3)} s after the change began.`);
  };
  return { graph, at };
}
