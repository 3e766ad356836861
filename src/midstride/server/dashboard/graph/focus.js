/**
 * The arrow keys on the graph: the next shape in a direction.
 *
 * @module
 */

/** @typedef {{x: number, y: number, width: number, height: number}} Box */

/** @type {Record<string, [number, number]>} */
const DIRECTIONS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

/**
 * @param {string} key of a keyboard event
 * @param {Element} from
 * @param {Iterable<Element>} candidates
 * @returns {Element | null} the nearest one in that direction; those beside it count as further away
 */
export function neighbour(key, from, candidates) {
  const direction = DIRECTIONS[key];
  if (direction === undefined) return null;
  const start = centre(from.getBoundingClientRect());
  let [best, least] = [/** @type {Element | null} */ (null), Infinity];
  for (const candidate of candidates) {
    if (candidate === from) continue;
    const end = centre(candidate.getBoundingClientRect());
    const [dx, dy] = [end.x - start.x, end.y - start.y];
    const along = dx * direction[0] + dy * direction[1];
    const across = Math.abs(dx * direction[1]) + Math.abs(dy * direction[0]);
    if (along <= 1) continue;
    const distance = along + 2.5 * across;
    if (distance < least) [best, least] = [candidate, distance];
  }
  return best;
}

/**
 * @param {Box} box
 * @returns {{x: number, y: number}}
 */
function centre({ x, y, width, height }) {
  return { x: x + width / 2, y: y + height / 2 };
}
