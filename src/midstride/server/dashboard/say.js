/**
 * A short message at the bottom of the page, which screen readers say too.
 *
 * @module
 */

let timer = 0;

/**
 * @param {string} text
 * @param {{kind?: "info" | "good" | "bad", seconds?: number}} [options]
 */
export function say(text, { kind = "info", seconds = 6 } = {}) {
  const element = /** @type {HTMLElement} */ (document.querySelector("#say"));
  element.dataset.kind = kind;
  element.textContent = text;
  clearTimeout(timer);
  timer = window.setTimeout(() => (element.textContent = ""), seconds * 1000);
}
