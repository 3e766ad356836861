/**
 * Search: components, topics and their types by a part of their names.
 *
 * @module
 */

import { h, replace } from "./dom.js";

/** @typedef {import("./panels.js").Context} Context */
/** @typedef {{name: string, label: string, words: string}} Found */

const MOST = 40;

/**
 * @param {import("./store.js").View} view
 * @param {string} text
 * @returns {Found[]} what begins with the text first
 */
export function search(view, text) {
  const sought = text.trim().toLowerCase();
  /** @type {Found[]} */
  const all = [
    ...Object.values(view.instances).map(({ name, component }) => ({ name, label: name, words: component })),
    ...Object.values(view.topics).map(({ name, type }) => ({ name: `topic:${name}`, label: name, words: type })),
  ];
  const rank = (/** @type {Found} */ { label, words }) => {
    const at = label.toLowerCase().indexOf(sought);
    return at === 0 ? 0 : at > 0 ? 1 : words.toLowerCase().includes(sought) ? 2 : 3;
  };
  return all
    .map((each) => ({ each, rank: rank(each) }))
    .filter((found) => found.rank < 3)
    .sort((a, b) => a.rank - b.rank || (a.each.label < b.each.label ? -1 : 1))
    .slice(0, MOST)
    .map(({ each }) => each);
}

/** @param {Context} context */
export function openSearch({ store, graph }) {
  const view = store.view;
  if (view === null || document.querySelector("dialog[open]")) return;
  const list = h("ul", { class: "found", role: "listbox", id: "found", "aria-label": "Found" });
  const input = /** @type {HTMLInputElement} */ (
    h("input", {
      type: "text",
      role: "combobox",
      "aria-label": "Search for a component, a topic or a service",
      "aria-expanded": "true",
      "aria-controls": "found",
      "aria-autocomplete": "list",
      placeholder: "component, topic or service",
      autocomplete: "off",
      spellcheck: "false",
    })
  );
  const dialog = /** @type {HTMLDialogElement} */ (h("dialog", { "aria-label": "Search" }, input, list));
  /** @type {Found[]} */ let found = [];
  let index = 0;
  const go = (/** @type {Found | undefined} */ chosen) => {
    dialog.close();
    if (chosen === undefined) return;
    store.select(chosen.name);
    graph.reveal(chosen.name);
  };
  const draw = () => {
    replace(
      list,
      ...found.map((each, at) =>
        h(
          "li",
          { role: "option", id: `found-${at}`, "aria-selected": at === index, onclick: () => go(each) },
          h("span", {}, each.label),
          h("span", { class: "muted" }, each.words),
        ),
      ),
    );
    list.querySelectorAll("li").forEach((each, at) => each.setAttribute("aria-selected", String(at === index)));
    if (found.length > 0) input.setAttribute("aria-activedescendant", `found-${index}`);
    else input.removeAttribute("aria-activedescendant");
    list.children[index]?.scrollIntoView({ block: "nearest" });
  };
  const look = () => {
    found = search(view, input.value);
    index = 0;
    draw();
  };
  input.addEventListener("input", look);
  input.addEventListener("keydown", (event) => {
    const step = event.key === "ArrowDown" ? 1 : event.key === "ArrowUp" ? -1 : 0;
    if (step !== 0 && found.length > 0) {
      index = (index + step + found.length) % found.length;
      draw();
    } else if (event.key === "Enter") go(found[index]);
    else return;
    event.preventDefault();
  });
  dialog.addEventListener("close", () => dialog.remove());
  document.body.append(dialog);
  dialog.showModal();
  look();
}
