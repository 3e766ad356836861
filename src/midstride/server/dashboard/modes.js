/**
 * How a mode looks: a colour, and always a glyph and words beside it.
 *
 * @module
 */

/**
 * @typedef {"normal" | "reduced" | "degraded" | "gone"} Kind
 * @typedef {{kind: Kind, glyph: string, words: string}} Look
 * @typedef {import("./store.js").Functionality} Functionality
 * @typedef {import("./store.js").Component} Component
 * @typedef {import("./store.js").View} View
 */

/** From best to worst. */
export const KINDS = /** @type {const} */ (["normal", "reduced", "degraded", "gone"]);

/** @type {Record<Kind, string>} */
export const GLYPHS = { normal: "●", reduced: "◐", degraded: "○", gone: "✕" };

/**
 * The look of a functionality: in its best mode, in its worst, or in one between.
 *
 * @param {Pick<Functionality, "mode" | "modes" | "normal">} functionality
 * @returns {Look}
 */
export function look(functionality) {
  const { mode, modes, normal } = functionality;
  const kind = normal ? "normal" : modes.indexOf(mode) === modes.length - 1 ? "degraded" : "reduced";
  return { kind, glyph: GLYPHS[kind], words: mode };
}

/**
 * The worst of several looks; without any, normal.
 *
 * @param {Look[]} looks
 * @returns {Look}
 */
function worst(looks) {
  return looks.reduce(
    (found, each) => (KINDS.indexOf(each.kind) > KINDS.indexOf(found.kind) ? each : found),
    { kind: "normal", glyph: GLYPHS.normal, words: "normal" },
  );
}

/**
 * The look of a component: "gone" if it has crashed, does not answer or its host cannot be reached, "done" if its program has ended as it should,
 * else that of its worst functionality.
 *
 * @param {Component} component
 * @param {Pick<View, "crashed">} view
 * @returns {Look}
 */
export function componentLook(component, view) {
  if (view.crashed.some((each) => each.name === component.name)) {
    return { kind: "gone", glyph: GLYPHS.gone, words: "crashed" };
  }
  if (!component.reachable && !component.done) {
    return { kind: "gone", glyph: GLYPHS.gone, words: component.unreachable ? `host ${component.host} cannot be reached` : "does not answer" };
  }
  if (component.done) return { kind: "normal", glyph: "✓", words: "done" };
  return worst(component.functionalities.map(look));
}

/**
 * Whether something of a component is not as the specification says, beyond its modes too.
 *
 * @param {Component} component
 * @returns {boolean}
 */
export function deviates(component) {
  return Boolean(component.deviation) || component.ports.some((port) => port.met === false);
}
