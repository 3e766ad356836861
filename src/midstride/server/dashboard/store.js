/**
 * What the page knows: the live view, kept by the stream; a view of the past while scrubbing; events; the selection.
 *
 * Who shows something subscribes to its keys, and is called at most once per animation frame.
 *
 * @module
 */

import { follow } from "./stream.js";

/**
 * The forms are those of docs/http.md (`Api`: tools/dashboard/api.d.ts); rates are in Hz, times in seconds, moments in unix seconds.
 *
 * @typedef {Api.FunctionalityStatus} Functionality
 * @typedef {Api.PortStatus} Port
 * @typedef {Api.ParameterStatus} Parameter
 * @typedef {Api.EndpointStatus} Endpoint
 * @typedef {Api.InstanceStatus} Component
 * @typedef {Api.TopicStatus} Topic
 * @typedef {Api.CrashedInstance} Crash
 * @typedef {Omit<Api.SystemView, "instances" | "topics"> & {instances: Record<string, Component>,
 *   topics: Record<string, Topic>}} View
 * @typedef {Api.Event} Event
 * @typedef {Api.PlanPreview & {alternatives?: Api.Alternative[], start?: Api.SpecificationForm | null,
 *   target?: Api.SpecificationForm | null, forbidden?: string, requires?: Api.RequirementStatus[]}} Plan
 * @typedef {{state: "connecting" | "live" | "lost" | "refused" | "ended", since: number, because: string | null,
 *   retryAt: number | null}} Connection
 * @typedef {{at: number | null, shown: number | null}} Time the moment that was asked for, and that whose view is shown; null is
 *   the present
 * @typedef {(method: string, path: string, document?: unknown, options?: {signal?: AbortSignal}) => Promise<any>} Ask
 */

const EVENTS_KEPT = 1000;

/**
 * A view with instances and topics by name. Without a prototype, so that no name means anything to the language.
 *
 * @param {Api.SystemView} document as GET /view sends it
 * @returns {View}
 */
export function byName(document) {
  const view = { ...document, instances: Object.create(null), topics: Object.create(null) };
  for (const each of document.instances) view.instances[each.name] = each;
  for (const each of document.topics) view.topics[each.name] = each;
  return view;
}

/**
 * The view after a patch. The one before stays as it was.
 *
 * @param {View} view
 * @param {Api.Patch} patch
 * @returns {{view: View, changed: Set<string>}} the keys that changed, as for `subscribe`
 */
function patched(view, patch) {
  const changed = new Set(Object.keys(patch));
  const next = { ...view, ...patch, instances: view.instances, topics: view.topics };
  for (const [plural, one] of /** @type {const} */ ([["instances", "instance"], ["topics", "topic"]])) {
    if (!patch[plural]) continue;
    const entries = Object.assign(Object.create(null), view[plural]);
    for (const [name, entry] of Object.entries(patch[plural])) {
      changed.add(`${one}:${name}`);
      if (entry === null) delete entries[name];
      else entries[name] = entry;
    }
    next[plural] = entries;
  }
  return { view: next, changed };
}

export class Store {
  /** @type {View | null} */ live = null;
  /** @type {Event[]} */ events = [];
  /** @type {Connection} */ connection;
  /** @type {Time} */ time = { at: null, shown: null };
  /** @type {string | null} */ selected = null;

  /** @type {View | null} */ #past = null;
  /** @type {Set<{keys: Set<string>, callback: (changed: Set<string>) => void}>} */ #subscribers = new Set();
  /** @type {Set<string>} */ #changed = new Set();
  #frame = 0;
  #offset = 0; // the manager's clock less this machine's, in seconds
  /** @type {AbortController | null} */ #scrubbing = null;
  /** @type {Ask} */ #ask;

  /** @param {Ask} ask */
  constructor(ask) {
    this.#ask = ask;
    this.connection = { state: "connecting", since: Date.now() / 1000, because: null, retryAt: null };
  }

  /** Begins to follow the manager. */
  connect() {
    follow({
      view: (document) => this.#onView(byName(document)),
      patch: (patch) => this.#onPatch(patch),
      event: (event) => this.#onEvent(event),
      connection: (connection) => {
        const since = connection.state === this.connection.state ? this.connection.since : Date.now() / 1000;
        this.connection = { ...connection, since };
        this.#notify(["connection"]);
      },
      clock: (at) => (this.#offset = at - Date.now() / 1000),
    });
  }

  /** The view that is shown: live, or of the past while scrubbing. */
  get view() {
    return this.time.at === null ? this.live : (this.#past ?? this.live);
  }

  /** The manager's clock, in unix seconds. */
  now() {
    return Date.now() / 1000 + this.#offset;
  }

  /**
   * Calls back once per animation frame in which one of the keys has changed: "instances", "instance:NAME", "topics",
   * "topic:NAME", a scalar of the view, "events", "connection", "time", "selection". It is not called at once.
   *
   * @param {Iterable<string>} keys
   * @param {(changed: Set<string>) => void} callback
   * @returns {() => void} ends it
   */
  subscribe(keys, callback) {
    const subscriber = { keys: new Set(keys), callback };
    this.#subscribers.add(subscriber);
    return () => void this.#subscribers.delete(subscriber);
  }

  /** @param {string | null} name a component, "topic:/name", or null */
  select(name) {
    if (name === this.selected) return;
    this.selected = name;
    this.#notify(["selection"]);
  }

  /**
   * Shows the view of a past time; null goes back to the present. The latest call wins.
   *
   * @param {number | null} at unix seconds
   * @throws {import("./api.js").ApiError}
   */
  async scrub(at) {
    this.#scrubbing?.abort();
    const mine = (this.#scrubbing = new AbortController());
    this.time = { at, shown: at === null ? null : this.time.shown };
    if (at === null) {
      this.#past = null;
      this.#notifyAll(["time"]);
      return;
    }
    this.#notify(["time"]);
    try {
      const document = await this.#ask("GET", `/view/at?at=${at}`, undefined, { signal: mine.signal });
      if (mine.signal.aborted) return;
      this.#past = byName(document);
      this.time = { at, shown: at };
      this.#notifyAll(["time"]);
    } catch (error) {
      if (mine.signal.aborted) return;
      this.time = { at: null, shown: null };
      this.#past = null;
      this.#notifyAll(["time"]);
      throw error;
    }
  }

  /** @param {View} view */
  #onView(view) {
    const another = this.live?.manager !== view.manager;
    if (another) this.events = []; // it numbers from the beginning
    this.live = view;
    if (another) void this.#recall(view.manager);
    this.#tick(view.at);
    if (this.time.at === null) this.#notifyAll(["events"]);
  }

  /** @param {Api.Patch} patch */
  #onPatch(patch) {
    if (this.live === null) return;
    const { view, changed } = patched(this.live, patch);
    this.live = view;
    this.#tick(patch.at);
    if (this.time.at === null) this.#notify(changed);
  }

  /**
   * Asks for the events before the stream began.
   *
   * @param {string} manager
   */
  async #recall(manager) {
    try {
      const events = await this.#ask("GET", "/log");
      if (this.live?.manager === manager) this.#addEvents(events);
    } catch {
      // the stream has new ones, and says itself if the manager is gone
    }
  }

  /** @param {Event} event */
  #onEvent(event) {
    this.#addEvents([event]);
  }

  /** @param {Event[]} events in order; those that are known already are left out */
  #addEvents(events) {
    const [first, last] = [this.events[0]?.n ?? Infinity, this.events.at(-1)?.n ?? 0];
    const before = events.filter(({ n }) => n < first);
    const after = events.filter(({ n }) => n > last && n >= first);
    this.events = [...before, ...this.events, ...(first === Infinity ? [] : after)].slice(-EVENTS_KEPT);
    this.#notify(["events"]);
  }

  /** @param {number} at since when the view is as it is, which is long ago where nothing happens */
  #tick(at) {
    this.#offset = Math.max(this.#offset, at - Date.now() / 1000);
  }

  /** @param {string[]} more */
  #notifyAll(more) {
    this.#notify(["*", ...more]);
  }

  /** @param {Iterable<string>} keys */
  #notify(keys) {
    for (const key of keys) this.#changed.add(key);
    if (this.#frame === 0) this.#frame = requestAnimationFrame(() => this.#deliver());
  }

  #deliver() {
    this.#frame = 0;
    const changed = this.#changed;
    this.#changed = new Set();
    for (const { keys, callback } of [...this.#subscribers]) {
      if (changed.has("*") || keys.has("*") || [...keys].some((key) => changed.has(key))) callback(changed);
    }
  }
}

/**
 * @param {Ask} ask
 * @returns {Store}
 */
export function createStore(ask) {
  return new Store(ask);
}
