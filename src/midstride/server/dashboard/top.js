/**
 * The bar: which system this is, how it is, whether what is shown is the present, and the switches of the page.
 *
 * @module
 */

import { clock, h, plural, replace, seconds } from "./dom.js";
import { kindOf } from "./graph/services.js";
import { openHelp } from "./help.js";
import { componentLook } from "./modes.js";
import { openSearch } from "./search.js";
import { change, isDark, settings } from "./settings.js";

/**
 * @typedef {import("./panels.js").Context} Context
 * @typedef {import("./store.js").View} View
 * @typedef {import("./store.js").Connection} Connection
 */

/**
 * @param {HTMLElement} element
 * @param {Context} context
 */
export function mountTop(element, context) {
  const { store } = context;
  const part = (/** @type {string} */ selector) => /** @type {HTMLElement} */ (document.querySelector(selector));
  const name = part("#system");
  const summary = part("#summary");
  const connection = part("#connection");
  const stale = part("#stale");
  let shown = "";

  const draw = () => {
    const view = store.view;
    if (view !== null) {
      name.textContent = view.system;
      document.title = `${view.system} · Midstride`;
      const parts = summaryOf(view);
      const text = JSON.stringify(parts);
      if (text !== shown) {
        shown = text;
        replace(summary, ...parts.map(({ kind, words }) => h("span", kind === "" ? {} : { "data-kind": kind }, words)));
      }
    }
  };
  const drawConnection = () => {
    const { kind, words } = inShort(store.connection, store.time);
    connection.dataset.kind = kind;
    connection.textContent = words;
    const warning = warningOf(store.connection, store.time.shown, store.view);
    stale.hidden = warning === null;
    stale.dataset.kind = store.connection.state === "live" ? "warn" : "bad";
    if (warning !== null && stale.textContent !== warning) stale.textContent = warning;
    document.documentElement.dataset.stale = String(store.connection.state !== "live" && store.view !== null);
  };
  replace(part("#tools"), ...tools(context));
  draw();
  drawConnection();
  store.subscribe(["instances", "crashed", "topics", "condition", "violations", "phase", "running", "lock", "requirements", "hosts", "system", "time"], draw);
  store.subscribe(["connection", "time", "instances"], drawConnection);
  setInterval(drawConnection, 1000);
  element.dataset.ready = "true";
}

/**
 * @param {View} view
 * @returns {{kind: string, words: string}[]}
 */
function summaryOf(view) {
  const components = Object.values(view.instances);
  const kinds = components.map((each) => componentLook(each, view).kind);
  const lowered = kinds.filter((kind) => kind === "reduced" || kind === "degraded").length;
  const silent = components.filter((each) => !each.reachable && !each.unreachable && !each.done).length;
  const low = components.flatMap((each) => each.ports).filter((port) => port.met === false).length;
  const connectors = Object.values(view.topics);
  const services = connectors.filter(({ type }) => kindOf(type) !== "topic").length;
  const counts = [plural(components.length, "component"), plural(connectors.length - services, "topic")];
  if (services > 0) counts.push(plural(services, "service"));
  const found = [{ kind: "", words: counts.join(" · ") }];
  const add = (/** @type {number} */ count, /** @type {string} */ kind, /** @type {string} */ words) => {
    if (count > 0) found.push({ kind, words });
  };
  add(lowered, "warn", `○ ${lowered} degraded`);
  add(low, "bad", `▼ ${plural(low, "rate")} too low`);
  add(view.crashed.length, "bad", `✕ ${view.crashed.length} crashed`);
  add(silent, "bad", `✕ ${silent} not answering`);
  add(view.violations.length, "bad", `▲ ${plural(view.violations.length, "violation")}`);
  const { condition } = view;
  if (found.length === 1 && condition) {
    const mark = condition.state === "up" ? "✓ " : "▲ ";
    found.push({ kind: condition.state === "up" && !condition.unknown?.length ? "good" : "warn", words: mark + condition.headline });
  } else if (condition && condition.state !== "up") {
    found.splice(1, 0, condition.state === "down" ? { kind: "bad", words: "✕ down" } : { kind: "warn", words: "▲ degraded" });
  }
  if (view.phase !== "up") found.push({ kind: "warn", words: view.phase });
  for (const host of view.hosts ?? []) {
    const nodes = plural(host.instances.length, "component");
    if (!host.connected) found.push({ kind: "bad", words: `✕ host ${host.name} unreachable since ${clock(host.since)} (${nodes}): ${host.because}` });
  }
  const { lock } = view;
  if (lock) found.push({ kind: "bad", words: `⚿ locked by ${lock.by}: ${lock.reason}` });
  for (const each of view.requirements ?? []) {
    if (!each.holds) found.push({ kind: "warn", words: `⚿ changes are refused: ${each.topic}, ${each.because}` });
  }
  if (view.running) found.push({ kind: "warn", words: `⟳ ${view.running.command}` });
  return found;
}

/**
 * @param {Connection} connection
 * @param {import("./store.js").Time} time
 * @returns {{kind: string, words: string}}
 */
function inShort(connection, { at, shown }) {
  if (connection.state === "connecting") return { kind: "warn", words: "◌ connecting" };
  if (connection.state === "refused") return { kind: "bad", words: "✕ refused" };
  if (connection.state !== "live") return { kind: "bad", words: "✕ connection lost" };
  if (at === null) return { kind: "good", words: "● live" };
  return { kind: "warn", words: at === shown ? `◷ ${clock(at)}` : `◌ ${clock(at)}` };
}

/**
 * @param {Connection} connection
 * @param {number | null} past the time that is shown, if it is not the present
 * @param {View | null} view
 * @returns {string | null} what has to be known before the picture is believed
 */
function warningOf(connection, past, view) {
  const now = Date.now() / 1000;
  if (connection.state === "live") {
    return past === null ? null : `What is shown is the past: ${clock(past)}.`;
  }
  if (connection.state === "connecting") return null;
  if (connection.state === "refused") {
    return `The manager refuses this page: ${connection.because}. Open it again with \`midstride dashboard\`.`;
  }
  const since = `for ${seconds(Math.max(1, now - connection.since))}, since ${clock(connection.since)}`;
  const picture = view === null ? "" : " What is shown is as it was then.";
  const retry = connection.retryAt === null || connection.retryAt <= now ? "now" : `in ${Math.ceil(connection.retryAt - now)} s`;
  return `No connection ${since}: ${connection.because}.${picture} Trying again ${retry}.`;
}

/**
 * @param {Context} context
 * @returns {HTMLElement[]}
 */
function tools(context) {
  const theme = h("button", { class: "button", type: "button" });
  const large = h("button", { class: "button", type: "button", title: "Large text, for a screen across the room" }, "A+");
  const show = () => {
    theme.textContent = isDark() ? "☀" : "☾";
    theme.title = isDark() ? "Light colours" : "Dark colours";
    theme.setAttribute("aria-label", theme.title);
    large.setAttribute("aria-pressed", String(settings.size === "large"));
    large.setAttribute("aria-label", "Large text");
    context.graph.viewport.fitLargest = settings.size === "large" ? 2.6 : 1.5;
  };
  theme.addEventListener("click", () => {
    change({ theme: isDark() ? "light" : "dark" });
    show();
  });
  large.addEventListener("click", () => {
    change({ size: settings.size === "large" ? "normal" : "large" });
    show();
    context.graph.viewport.fit();
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", show);
  show();
  return [
    h("button", { class: "button", type: "button", onclick: () => openSearch(context) }, h("span", { class: "label" }, "Search "), h("kbd", {}, "/")),
    large,
    theme,
    h("button", { class: "button", type: "button", "aria-label": "Help", onclick: openHelp }, "?"),
  ];
}
