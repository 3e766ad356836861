/**
 * Elements, and numbers as text. Text from the system goes into text nodes only: a name that looks like HTML is shown as it is.
 *
 * @module
 */

const SVG = "http://www.w3.org/2000/svg";

/**
 * @typedef {Node | string | number | null | undefined | false} Child
 * @typedef {Record<string, unknown>} Attributes
 */

/**
 * @template {Element} E
 * @param {E} element
 * @param {Attributes} attributes `onclick` and the like are functions; true is an empty attribute, false and null are none
 * @param {Child[]} children
 * @returns {E}
 */
function fill(element, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) {
      if (typeof value !== "function") throw new TypeError(`${name} takes a function`);
      element.addEventListener(name.slice(2), /** @type {EventListener} */ (value));
    } else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(name, String(value));
  }
  element.append(...nodes(children));
  return element;
}

/**
 * @param {Child[]} children
 * @returns {(Node | string)[]}
 */
function nodes(children) {
  return children
    .filter((child) => child !== null && child !== undefined && child !== false)
    .map((child) => (child instanceof Node ? child : String(child)));
}

/**
 * An HTML element.
 *
 * @param {string} tag
 * @param {Attributes} [attributes]
 * @param {...Child} children
 * @returns {HTMLElement}
 */
export function h(tag, attributes = {}, ...children) {
  return fill(document.createElement(tag), attributes, children);
}

/**
 * An SVG element.
 *
 * @param {string} tag
 * @param {Attributes} [attributes]
 * @param {...Child} children
 * @returns {SVGElement}
 */
export function s(tag, attributes = {}, ...children) {
  return fill(/** @type {SVGElement} */ (document.createElementNS(SVG, tag)), attributes, children);
}

/**
 * @param {Element} element
 * @param {...Child} children
 */
export function replace(element, ...children) {
  element.replaceChildren(...nodes(children));
}

/**
 * Set an attribute only where it changes: every write costs the browser a style calculation.
 *
 * @param {Element} element
 * @param {string} name
 * @param {string | number} value
 */
export function set(element, name, value) {
  const text = String(value);
  if (element.getAttribute(name) !== text) element.setAttribute(name, text);
}

/**
 * @param {Element} element
 * @param {string} text
 */
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/**
 * @param {number} count
 * @param {string} noun
 * @returns {string} as "1 node", "3 nodes"
 */
export function plural(count, noun) {
  const ending = count === 1 ? "" : /[^aeiou]y$/.test(noun) ? "ies" : "s";
  return `${count} ${ending === "ies" ? noun.slice(0, -1) : noun}${ending}`;
}

/**
 * @param {number} at unix seconds
 * @returns {string} the local time of day, as "20:36:14.9"
 */
export function clock(at) {
  const time = new Date(Math.round(at * 10) * 100);
  const parts = [time.getHours(), time.getMinutes(), time.getSeconds()].map((part) => String(part).padStart(2, "0"));
  return `${parts.join(":")}.${Math.floor(time.getMilliseconds() / 100)}`;
}

/**
 * @param {number} duration in seconds
 * @returns {string} as "80 ms", "11.4 s", "3 min 20 s", "2 h 5 min"
 */
export function seconds(duration) {
  if (duration < 0.9995) return `${Math.round(duration * 1000)} ms`;
  if (duration < 10) return `${duration.toFixed(1)} s`;
  if (duration < 60) return `${Math.floor(duration)} s`;
  if (duration < 3600) return `${Math.floor(duration / 60)} min ${Math.floor(duration % 60)} s`;
  return `${Math.floor(duration / 3600)} h ${Math.floor((duration % 3600) / 60)} min`;
}

/**
 * @param {number} rate
 * @returns {string} three significant digits, as "9.98", "50", "1000"
 */
export function hz(rate) {
  return rate >= 100 ? String(Math.round(rate)) : String(Number(rate.toPrecision(3)));
}

/**
 * The value of a parameter, a text as it is, numbers that are not finite as YAML has them.
 *
 * @param {unknown} value in its form in the API
 * @returns {string}
 */
export function valueText(value) {
  return typeof value === "string" ? value : written(value);
}

/** @param {unknown} value @returns {string} */
function written(value) {
  if (Array.isArray(value)) return `[${value.map(written).join(",")}]`;
  if (value !== null && typeof value === "object" && "float" in value) return String(value.float).replace(/(?=inf|nan)/, ".");
  return JSON.stringify(value);
}
