/**
 * What the shapes mean, and the keys.
 *
 * @module
 */

import { h } from "./dom.js";

const KEYS = [
  ["Tab, ← ↑ → ↓", "from one component to the next; the arrows reach topics too"],
  ["Enter", "shows the details of a component, topic or service, opens or closes a group"],
  ["/", "search for a component, topic, service or group"],
  ["Esc", "clears the selection, and what is highlighted"],
  ["+ −", "zoom"],
  ["0", "shows the whole graph"],
  ["N", "back to the present, where the timeline shows an earlier time"],
  ["L", "large text, for a screen across the room"],
  ["D", "dark or light"],
  ["?", "this help"],
];

const LEGEND = [
  ["●", "a functionality in its normal mode"],
  ["◐", "in a mode between normal and degraded"],
  ["○", "degraded"],
  ["✕", "crashed, or does not answer"],
  ["9.98 / 10 Hz", "a port: the measured rate, and the one that its contract states"],
  ["▼", "the measured rate is too low for the contract"],
  ["▲", "something else is not as the specification says"],
  ["⊘", "the gate of an output is closed: its messages are held back"],
  ["⇥", "a topic that is published from outside the system too"],
  ["⇄", "a server or client of a service or ROS action; dotted lines lead from the server to the clients"],
  ["+ −", "a plan will create, or remove"],
  ["↓", "a plan lowers this functionality meanwhile"],
];

/** @type {HTMLDialogElement | null} */ let dialog = null;

export function openHelp() {
  if (dialog === null) {
    const rows = (/** @type {string[][]} */ pairs, /** @type {boolean} */ keys) =>
      pairs.flatMap(([term, words]) => [h("dt", {}, keys ? h("kbd", {}, term) : term), h("dd", {}, words)]);
    dialog = /** @type {HTMLDialogElement} */ (
      h(
        "dialog",
        { "aria-labelledby": "help-title" },
        h("h2", { id: "help-title" }, "Keys and signs"),
        h("dl", { class: "keys" }, ...rows(KEYS, true)),
        h("dl", { class: "keys" }, ...rows(LEGEND, false)),
        h("form", { method: "dialog" }, h("button", { class: "button primary" }, "Close")),
      )
    );
    document.body.append(dialog);
  }
  if (!dialog.open) dialog.showModal();
}
