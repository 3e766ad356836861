/**
 * Names of the system in sentences, and how names of one thing contain those of another.
 *
 * @module
 */

/** @typedef {import("../store.js").View} View */

/**
 * The component that a name of it, of its port or of its functionality belongs to.
 *
 * @param {string} name as "listener", "listener.in"; not a topic
 * @returns {string}
 */
export function owner(name) {
  const dot = name.lastIndexOf(".");
  return dot < 0 ? name : name.slice(0, dot);
}

/**
 * The components, functionalities, ports and topics that sentences mention.
 *
 * @param {string | string[]} words
 * @param {View} view
 * @returns {string[]}
 */
export function namesIn(words, view) {
  const found = new Set();
  const text = Array.isArray(words) ? words.join("\n") : words;
  for (const raw of text.match(/[\w/.~-]+/g) ?? []) {
    const name = raw.replace(/[.:,;-]+$/, "");
    if (name in view.topics || name in view.instances || owner(name) in view.instances) found.add(name);
  }
  return [...found];
}
