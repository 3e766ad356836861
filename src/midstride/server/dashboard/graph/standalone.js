/**
 * The picture as a file: an SVG with the styles that it has on the page.
 *
 * @module
 */

import { s } from "../dom.js";
import { allTips } from "./tips.js";

const MARGIN = 16;

/**
 * @param {SVGElement} svg
 * @param {SVGElement} world
 * @returns {string}
 */
export function standalone(svg, world) {
  const box = /** @type {SVGGraphicsElement} */ (world).getBBox();
  const copy = /** @type {SVGElement} */ (svg.cloneNode(true));
  copy.querySelector(".world")?.removeAttribute("transform");
  copy.removeAttribute("data-detail");
  allTips(copy);
  const [width, height] = [box.width + 2 * MARGIN, box.height + 2 * MARGIN];
  copy.setAttribute("xmlns", "http://www.w3.org/2000/svg");
  copy.setAttribute("viewBox", `${box.x - MARGIN} ${box.y - MARGIN} ${width} ${height}`);
  copy.setAttribute("width", String(Math.ceil(width)));
  copy.setAttribute("height", String(Math.ceil(height)));
  copy.prepend(s("style", {}, styles()));
  return new XMLSerializer().serializeToString(copy);
}

/** @returns {string} the rules of graph.css, with the values that its variables have now */
function styles() {
  const rules = [...document.styleSheets]
    .filter((sheet) => sheet.href?.endsWith("/graph.css"))
    .flatMap((sheet) => [...sheet.cssRules].map((rule) => rule.cssText))
    .join("\n");
  const now = getComputedStyle(document.documentElement);
  const names = new Set([...rules.matchAll(/var\((--[\w-]+)/g)].map(([, name]) => name));
  const values = [...names].map((name) => [name, resolved(now.getPropertyValue(name).trim())]).filter(([, value]) => value !== "");
  return `svg{${values.map(([name, value]) => `${name}:${value}`).join(";")}}\n${rules}`;
}

/**
 * @param {string} value of a variable
 * @returns {string} a colour as it is now, light or dark; anything else as it is
 */
function resolved(value) {
  if (!value.startsWith("light-dark(")) return value;
  const probe = document.createElement("span");
  probe.style.color = value;
  document.body.append(probe);
  const colour = getComputedStyle(probe).color;
  probe.remove();
  return colour;
}
