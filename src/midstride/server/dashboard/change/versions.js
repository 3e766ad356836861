/**
 * The versions of the specification that can be gone back to.
 *
 * @module
 */

/**
 * @param {Api.History} history as GET /history answers
 * @returns {[number, string][]} each with what made it, the latest first; without the one that is in force
 */
export function earlierVersions({ changes }) {
  /** @type {Map<number, string>} */ const found = new Map();
  for (const { version, command, outcome } of changes) {
    if (outcome === "done" && !found.has(version)) found.set(version, command);
  }
  const now = changes.at(-1)?.version;
  return [...found].filter(([version]) => version !== now).sort(([a], [b]) => b - a);
}
