/**
 * The tooltip of a shape says what a screen reader says of it. It is made when the pointer comes: shapes are many, and change.
 *
 * @module
 */

import { s, setText } from "../dom.js";

/** @param {SVGElement} svg */
export function mountTips(svg) {
  svg.addEventListener("pointerover", (event) => {
    const shape = /** @type {Element} */ (event.target).closest("[role='button'][aria-label]");
    if (shape !== null) tip(shape);
  });
}

/** @param {SVGElement} picture gets all of them: nothing listens in a file */
export function allTips(picture) {
  for (const shape of picture.querySelectorAll("[role='button'][aria-label]")) tip(shape);
}

/** @param {Element} shape */
function tip(shape) {
  let title = shape.querySelector(":scope > title");
  if (title === null) shape.prepend((title = s("title")));
  setText(title, shape.getAttribute("aria-label") ?? "");
}
