/**
 * A linear scale of time, and round numbers to label it with.
 *
 * @module
 */

/** @typedef {{from: number, to: number, x: (at: number) => number, at: (x: number) => number}} Scale */

/**
 * @param {number} from seconds
 * @param {number} to seconds
 * @param {number} left pixels
 * @param {number} right pixels
 * @returns {Scale}
 */
export function scale(from, to, left, right) {
  const span = Math.max(to - from, 1e-9);
  const width = Math.max(right - left, 1);
  return {
    from,
    to,
    x: (at) => left + ((Math.min(Math.max(at, from), to) - from) / span) * width,
    at: (x) => from + ((Math.min(Math.max(x, left), right) - left) / width) * span,
  };
}

const STEPS = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400, 43200, 86400];

/**
 * A distance between labels so that there are at most `most`: 1, 2 or 5 times a power of ten below a second, what
 * people count time in above.
 *
 * @param {number} span seconds
 * @param {number} most
 * @returns {number} seconds
 */
export function tickStep(span, most) {
  const least = span / Math.max(most, 1);
  if (least <= 0.5) {
    const power = 10 ** Math.floor(Math.log10(least));
    return [1, 2, 5, 10].map((factor) => factor * power).find((step) => step >= least * 0.999) ?? 10 * power;
  }
  return STEPS.find((step) => step >= least) ?? Math.ceil(least / 86400) * 86400;
}

/**
 * @param {number} from
 * @param {number} to
 * @param {number} most how many at most
 * @param {number} [origin] where one of them is, inside or outside
 * @returns {number[]}
 */
export function ticks(from, to, most, origin = 0) {
  const step = tickStep(to - from, most);
  const first = Math.ceil((from - origin) / step - 1e-9);
  const last = Math.floor((to - origin) / step + 1e-9);
  return Array.from({ length: Math.max(last - first + 1, 0) }, (_, index) => origin + (first + index) * step);
}

/**
 * @param {number} offset seconds from a moment
 * @param {number} step between labels
 * @returns {string} as "-80 s", "-5 min", "0", "1.5 s", "200 ms"
 */
export function tickLabel(offset, step) {
  if (Math.abs(offset) < step / 1000) return "0";
  if (step >= 60) {
    const minutes = offset / 60;
    return Math.abs(minutes) >= 120 ? `${trim(minutes / 60)} h` : `${trim(minutes)} min`;
  }
  return step < 0.1 ? `${Math.round(offset * 1000)} ms` : `${trim(offset)} s`;
}

/** @param {number} value */
function trim(value) {
  return String(Number(value.toFixed(1)));
}
