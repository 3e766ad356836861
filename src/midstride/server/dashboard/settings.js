/**
 * How the user wants the page to look: kept in this browser.
 *
 * @module
 */

const STORAGE = "midstride-settings";

/**
 * @typedef {{theme: "system" | "light" | "dark", size: "normal" | "large", grouping: "namespace" | "host" | "none"}} Settings
 */

/** @type {Settings} */
const DEFAULTS = { theme: "system", size: "normal", grouping: "namespace" };

/** @returns {Settings} */
function stored() {
  try {
    return { ...DEFAULTS, ...JSON.parse(localStorage.getItem(STORAGE) ?? "{}") };
  } catch {
    return { ...DEFAULTS };
  }
}

export const settings = stored();

/** @param {Partial<Settings>} changes */
export function change(changes) {
  Object.assign(settings, changes);
  apply();
  try {
    localStorage.setItem(STORAGE, JSON.stringify(settings));
  } catch {
    // no storage: it lasts as long as the page
  }
}

export function apply() {
  const root = document.documentElement;
  if (settings.theme === "system") delete root.dataset.theme;
  else root.dataset.theme = settings.theme;
  root.dataset.size = settings.size;
}

/** @returns {boolean} whether the page is dark now */
export function isDark() {
  return settings.theme === "dark" || (settings.theme === "system" && matchMedia("(prefers-color-scheme: dark)").matches);
}
