/**
 * The modes of functionalities over time, by role: what the timeline draws, as data.
 *
 * @module
 */

/**
 * @typedef {import("../modes.js").Kind} Kind
 * @typedef {{instance: string, role: string, functionality: string, mode: string, level: number, levels: number,
 *   because: string | null, reflex: boolean, began: number, ended: number | null}} Interval
 * @typedef {{from: number, to: number, open: boolean, kind: Kind, interval: Interval}} Segment
 * @typedef {{name: string, segments: Segment[], lowered: boolean}} Row
 */

/** @param {Interval} interval @returns {Kind} */
export function kindOf(interval) {
  if (interval.level === 0) return "normal";
  return interval.level >= interval.levels - 1 ? "degraded" : "reduced";
}

/**
 * A row for each functionality of a role, and what its instances were in: of two instances, the better mode counts, as
 * for the planner. What was lowered comes first, the latest fall above.
 *
 * @param {Interval[]} intervals
 * @param {number} since unix seconds
 * @param {number} until
 * @returns {Row[]}
 */
export function rows(intervals, since, until) {
  /** @type {Map<string, Interval[]>} */ const byName = new Map();
  for (const each of intervals) {
    if (each.began > until || (each.ended ?? until) < since) continue;
    const name = `${each.role}.${each.functionality}`;
    const known = byName.get(name);
    if (known) known.push(each);
    else byName.set(name, [each]);
  }
  const found = [...byName].map(([name, each]) => {
    const segments = merged(each, since, until);
    return { name, segments, lowered: segments.some((segment) => segment.kind !== "normal") };
  });
  return found.sort((a, b) => lastFall(b) - lastFall(a) || (a.name < b.name ? -1 : 1));
}

/** @param {Row} row */
function lastFall(row) {
  return Math.max(0, ...row.segments.filter((each) => each.kind !== "normal").map((each) => each.interval.began));
}

/**
 * The intervals of one functionality of one role without overlaps: at each time, the best of them.
 *
 * @param {Interval[]} intervals
 * @param {number} since
 * @param {number} until
 * @returns {Segment[]}
 */
function merged(intervals, since, until) {
  const cuts = new Set([since, until]);
  for (const each of intervals) {
    cuts.add(Math.max(each.began, since));
    cuts.add(Math.min(each.ended ?? until, until));
  }
  const at = [...cuts].sort((a, b) => a - b);
  /** @type {Segment[]} */ const segments = [];
  for (let index = 0; index + 1 < at.length; index += 1) {
    const [from, to] = [at[index], at[index + 1]];
    const here = intervals.filter((each) => each.began <= from && (each.ended ?? until) >= to);
    if (!here.length) continue;
    const interval = here.reduce((best, each) => (each.level < best.level ? each : best));
    const last = segments.at(-1);
    if (last && last.to === from && last.interval.mode === interval.mode && last.interval.because === interval.because) {
      last.to = to;
      last.interval = interval;
      last.open = interval.ended === null;
    } else segments.push({ from, to, open: interval.ended === null, kind: kindOf(interval), interval });
  }
  return segments;
}

/** Which events are marked above the rows, with what, and how. */
const MARKS = /** @type {Record<string, [string, "bad" | "warn" | "info"]>} */ ({
  exited: ["✕", "bad"],
  up_failed: ["✕", "bad"],
  rollback_failed: ["✕", "bad"],
  fenced: ["⊘", "bad"],
  silence: ["…", "bad"],
  step_failed: ["!", "bad"],
  degraded: ["↓", "warn"],
  rollback: ["↶", "warn"],
  restore: ["↑", "warn"],
  restore_ended: ["!", "warn"],
  respawn: ["↻", "warn"],
  respawn_ended: ["!", "bad"],
  parameters: ["=", "info"],
});

/**
 * @param {import("../store.js").Event[]} events
 * @param {number} since
 * @param {number} until
 * @returns {{at: number, glyph: string, kind: "bad" | "warn" | "info", words: string}[]}
 */
export function marks(events, since, until) {
  return events
    .filter((each) => each.kind in MARKS && each.at >= since && each.at <= until)
    .map((each) => ({ at: each.at, glyph: MARKS[each.kind][0], kind: MARKS[each.kind][1], words: each.words.split("\n")[0] }));
}
