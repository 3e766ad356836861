/**
 * The panel of the timeline: a window into the past, live or stopped at a time that the graph then shows.
 *
 * @module
 */

import { clock, h, replace, seconds } from "../dom.js";
import { drawChart } from "./chart.js";
import { rows } from "./intervals.js";
import { Why } from "./why.js";

/** How far back each window reaches (s); the last one as far as the manager remembers. */
const WINDOWS = /** @type {[string, number][]} */ ([["1 min", 60], ["5 min", 300], ["30 min", 1800], ["all", Infinity]]);
/** Of so many functionalities, all are shown; of more, those that were lowered. */
const FEW = 12;
const MOST = 300;
/** How often the picture moves on (ms), and how often the modes are asked for at least. */
const TICK = 1000;
const REFRESH = 10_000;

/**
 * @typedef {import("../store.js").Store} Store
 * @typedef {Pick<Store, "view" | "live" | "time" | "now" | "subscribe" | "scrub"> & {connection: {state: string}}} Source
 * @typedef {Omit<import("../panels.js").Context, "store"> & {store: Source, fixed?: [number, number]}} Context `fixed`: the
 *   time that is shown, where that is all there is
 */

/**
 * @param {HTMLElement} element
 * @param {Context} context
 */
export function mountTimeline(element, context) {
  new Timeline(element, context);
}

class Timeline {
  #window = WINDOWS[0][1];
  #all = false;
  /** @type {Api.Timeline | null} */ #document = null;
  /** @type {import("./chart.js").Chart | null} */ #chart = null;
  #asked = 0;
  #asking = false;
  #again = false;
  #held = 0; // the end of the picture while it is stopped
  #drag = false;
  #why;

  /**
   * @param {HTMLElement} element
   * @param {Context} context
   */
  constructor(element, context) {
    this.context = context;
    this.#why = new Why(context);
    this.choices = h("span", { class: "timeline-windows", role: "group", "aria-label": "How far back" });
    this.more = h("button", { class: "button quiet", type: "button", onclick: () => ((this.#all = !this.#all), this.#draw()) });
    this.live = h("button", { class: "button", type: "button", title: "Key: Escape, or N for now", onclick: () => this.#scrub(null) }, "Live");
    this.words = h("span", { class: "timeline-words", role: "status" });
    this.picture = h("div", { class: "timeline-picture" });
    // Beside the picture, not around it: what is inside of a slider is not there for a screen reader.
    this.handle = h("div", { class: "timeline-handle", role: "slider", tabindex: 0, "aria-label": "Time that is shown", "aria-orientation": "horizontal" });
    this.slider = h("div", { class: "timeline-slider" }, this.handle, this.picture);
    const head = h("div", { class: "timeline-head" }, h("h2", { class: "panel-title" }, "Timeline"), this.choices, this.more, this.words, this.live);
    replace(element, head, this.slider, this.#why.element);
    for (const [name, back] of WINDOWS) {
      this.choices.append(h("button", { class: "button", type: "button", "data-seconds": back, onclick: () => this.#choose(back) }, name));
    }
    this.slider.addEventListener("keydown", (event) => this.#onKey(event));
    this.slider.addEventListener("pointerdown", (event) => this.#onPointer(event));
    this.slider.addEventListener("pointermove", (event) => this.#drag && this.#to(event));
    for (const kind of ["pointerup", "pointercancel"]) this.slider.addEventListener(kind, () => (this.#drag = false));
    document.addEventListener("keydown", (event) => {
      const typing = /** @type {HTMLElement} */ (event.target).closest?.("input, select, textarea, dialog");
      if (event.key.toLowerCase() === "n" && !typing && !event.ctrlKey && !event.metaKey && !event.altKey) this.#scrub(null);
    });
    new ResizeObserver(() => this.#draw()).observe(this.slider);
    const { store } = context;
    store.subscribe(["events", "connection"], () => this.#refresh());
    store.subscribe(["time"], () => this.#draw());
    this.choices.hidden = context.fixed !== undefined;
    if (!context.fixed) setInterval(() => this.#tick(), TICK);
    this.#choose(this.#window);
  }

  /** @param {number} back in seconds */
  #choose(back) {
    this.#window = back;
    for (const each of this.choices.querySelectorAll("button")) {
      each.setAttribute("aria-pressed", String(each.dataset.seconds === String(back)));
    }
    this.#refresh();
  }

  #tick() {
    if (document.hidden) return;
    if (performance.now() - this.#asked > REFRESH) this.#refresh();
    else if (this.context.store.time.at === null) this.#draw();
  }

  /** Asks for the modes: at once, or again after the answer that is awaited. */
  async #refresh() {
    const { store, ask } = this.context;
    if (store.connection.state !== "live") return;
    if (this.#asking) {
      this.#again = true;
      return;
    }
    this.#asking = true;
    this.#asked = performance.now();
    const now = store.now();
    const since = this.#window === Infinity ? 0 : now - this.#window;
    try {
      this.#document = await ask("GET", `/view/timeline?since=${since}&until=${now + 60}`);
      this.#draw();
    } catch {
      // The connection's state says so, at the top of the page; the last picture stays.
    }
    this.#asking = false;
    if (this.#again) {
      this.#again = false;
      setTimeout(() => this.#refresh(), 250);
    }
  }

  // -- the time that is shown ---------------------------------------------------------------------------

  /** @returns {[number, number]} */
  #range() {
    const { store, fixed } = this.context;
    if (fixed) return fixed;
    const until = store.time.at === null ? store.now() : Math.max(this.#held, store.time.at);
    const oldest = this.#document?.oldest ?? until - 60;
    const since = this.#window === Infinity ? Math.min(oldest, until - 10) : until - this.#window;
    return [since, until];
  }

  /** @param {number | null} at */
  #scrub(at) {
    const { store, say } = this.context;
    if (at === null && store.time.at === null) return;
    if (store.time.at === null) this.#held = store.now();
    const [since, until] = this.#range();
    const oldest = Math.max(this.#document?.oldest ?? since, since);
    const to = at === null ? null : Math.min(Math.max(at, oldest), until);
    store.scrub(to).catch((/** @type {Error} */ error) => say(error.message, { kind: "bad", seconds: 6 }));
    if (to === null) this.#refresh();
  }

  /** @param {KeyboardEvent} event */
  #onKey(event) {
    const { store } = this.context;
    const [since, until] = this.#range();
    const at = store.time.at ?? until;
    const step = (until - since) / 100;
    const events = this.#moments();
    /** @type {Record<string, () => number | null>} */
    const moves = {
      ArrowLeft: () => at - step,
      ArrowRight: () => (at + step >= until ? null : at + step),
      PageUp: () => [...events].reverse().find((each) => each < at - 1e-3) ?? since,
      PageDown: () => events.find((each) => each > at + 1e-3) ?? null,
      Home: () => since,
      End: () => null,
      Escape: () => null,
    };
    const move = moves[event.key];
    if (!move || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    event.stopPropagation();
    this.#scrub(move());
  }

  /** When something happened, for the keys that go from one to the next. @returns {number[]} */
  #moments() {
    const { modes = [], changes = [] } = this.#document ?? {};
    const found = [...modes.filter((each) => each.level).map((each) => each.began)];
    found.push(...changes.map((each) => each.began));
    return found.sort((a, b) => a - b);
  }

  /** @param {PointerEvent} event */
  #onPointer(event) {
    if (event.button !== 0 || /** @type {Element} */ (event.target).closest('[role="button"]')) return;
    this.#drag = true;
    this.slider.setPointerCapture(event.pointerId);
    this.#to(event);
  }

  /** @param {PointerEvent} event */
  #to(event) {
    const left = this.picture.getBoundingClientRect().left;
    if (this.#chart) this.#scrub(this.#chart.at(event.clientX - left));
  }

  // -- the picture --------------------------------------------------------------------------------------

  #draw() {
    const { store } = this.context;
    const width = this.slider.clientWidth - 16;
    if (!this.#document || width < 100) return;
    const [since, until] = this.#range();
    const every = rows(this.#document.modes, since, until);
    const lowered = every.filter((row) => row.lowered);
    const shown = this.#all || every.length <= FEW ? every.slice(0, MOST) : lowered.slice(0, MOST);
    const held = this.#focused();
    const at = store.time.at;
    const { fixed } = this.context;
    const origin = fixed ? this.#document.since : until;
    const picture = { ...this.#document, rows: shown, since, until, at, origin, live: at === null && !fixed };
    this.#chart = drawChart(picture, width, (row, segment) => this.#why.show(row, segment));
    replace(this.picture, this.#chart.svg);
    this.#refocus(held);
    this.more.hidden = every.length <= FEW;
    replace(this.more, this.#all ? "Only what was lowered" : `All ${every.length} functionalities`);
    this.live.hidden = at === null;
    replace(this.live, fixed ? "Whole change" : "Live");
    const none = shown.length ? "" : "Nothing was lowered in this time.";
    replace(this.words, at === null ? none : `The graph shows ${clock(at)}, ${seconds(until - at)} before the end.`);
    this.handle.setAttribute("aria-valuemin", String(Math.round(since)));
    this.handle.setAttribute("aria-valuemax", String(Math.round(until)));
    this.handle.setAttribute("aria-valuenow", String(Math.round(at ?? until)));
    this.handle.setAttribute("aria-valuetext", at === null ? "live" : clock(at));
  }

  /** Which stretch has the focus: the picture is drawn anew each second. */
  #focused() {
    const found = document.activeElement?.closest?.(".timeline-picture .segment");
    if (!found) return null;
    const row = /** @type {Element} */ (found.parentElement);
    return [row.getAttribute("data-name"), [...row.querySelectorAll('[role="button"]')].indexOf(found)];
  }

  /** @param {(string | number | null)[] | null} held */
  #refocus(held) {
    if (!held) return;
    const row = [...this.picture.querySelectorAll(".timeline-row")].find((each) => each.getAttribute("data-name") === held[0]);
    const found = row?.querySelectorAll('[role="button"]')[/** @type {number} */ (held[1])];
    /** @type {HTMLElement | undefined} */ (found)?.focus({ preventScroll: true });
  }
}
