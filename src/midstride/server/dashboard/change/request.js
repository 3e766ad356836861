/**
 * A change as a request to the manager, and as the command that asks for the same.
 *
 * @module
 */

/**
 * @typedef {{kind: "replace" | "restart" | "remove" | "apply", node: string, component: string, to: any,
 *   file: string | null, strategy: string, detours: boolean, declared: boolean, verify: boolean}} Choice
 */

export const STRATEGIES = ["minimal", "paper", "quiesce", "stop"];

/** @type {Choice} */
export const NOTHING = {
  kind: "replace",
  node: "",
  component: "",
  to: null,
  file: null,
  strategy: "minimal",
  detours: false,
  declared: false,
  verify: false,
};

/** @param {Choice} choice @returns {boolean} whether there is something to plan */
export function complete(choice) {
  if (choice.kind === "apply") return choice.to !== null;
  return choice.node !== "" && (choice.kind !== "replace" || choice.component !== "");
}

/** @param {Choice} choice @returns {Record<string, unknown>} the document of POST /plan, and `request` of POST /change */
export function request(choice) {
  /** @type {Record<string, unknown>} */
  const document = { strategy: choice.strategy };
  if (choice.detours && choice.strategy === "minimal") document.detours = true;
  if (choice.declared && choice.kind !== "remove") document.declared_parameters = true;
  if (choice.kind === "replace") document.replace = [[choice.node, choice.component]];
  else if (choice.kind === "apply") document.to = choice.to;
  else document[choice.kind] = [choice.node];
  return document;
}

/** A word as a shell takes it. @param {string} text */
export function quoted(text) {
  return /^[\w@%+=:,./-]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`;
}

/** @param {Choice} choice @returns {string[]} the words after `midstride` that name the change */
function words(choice) {
  switch (choice.kind) {
    case "replace":
      return ["replace", choice.node, choice.component];
    case "apply":
      return ["apply", choice.file ?? "NEW.stride", "--keep-code"];
    default:
      return [choice.kind, choice.node];
  }
}

/** @param {Choice} choice */
function options(choice) {
  const found = choice.strategy === "minimal" ? [] : ["--strategy", choice.strategy];
  if (choice.detours && choice.strategy === "minimal") found.push("--detours");
  if (choice.declared && choice.kind !== "remove") found.push("--declared-parameters");
  return found;
}

/** @param {string[]} found */
function command(found) {
  return ["midstride", ...found.map(quoted)].join(" ");
}

/** @param {Choice} choice @returns {string} the command that makes the change */
export function changeCommand(choice) {
  return command([...words(choice), ...options(choice), ...(choice.verify ? ["--verify"] : [])]);
}

/** @param {Choice} choice @param {string[]} [more] @returns {string} the command that shows the plan */
export function planCommand(choice, more = []) {
  /** @type {Record<Choice["kind"], string[]>} */
  const change = {
    replace: ["--replace", `${choice.node}=${choice.component}`],
    restart: ["--restart", choice.node],
    remove: ["--remove", choice.node],
    apply: ["--to", choice.file ?? "NEW.stride"],
  };
  return command(["plan", ...change[choice.kind], ...options(choice), ...more]);
}

/** @param {Choice} choice @param {string} file @param {number} seeds @returns {string} the command that rehearses it */
export function rehearsalCommand(choice, file, seeds) {
  const plan = planCommand(choice).split(" ").slice(2).join(" ");
  return `midstride simulate ${quoted(file)} ${plan} --seeds ${seeds}`;
}

/** @param {Choice} choice @returns {string} the change in a few words, as the history has it */
export function title(choice) {
  switch (choice.kind) {
    case "replace":
      return `replace ${choice.node} with ${choice.component}`;
    case "apply":
      return `apply ${choice.file ?? "a specification"}`;
    default:
      return `${choice.kind} ${choice.node}`;
  }
}

/**
 * The components that may take a node's place: what it falls back to first, then those with all its ports, then others.
 *
 * @param {any} specification
 * @param {string} role
 * @returns {{name: string, fits: boolean, words: string}[]}
 */
export function replacements(specification, role) {
  const node = specification?.nodes?.[role];
  if (!node) return [];
  const needed = Object.keys(node.attachments ?? {});
  const found = Object.entries(specification.components).map(([name, component]) => {
    const missing = needed.filter((port) => !ports(component).has(port));
    const fallback = node.respawn?.fallback === name;
    const same = node.component === name;
    const words = [same ? "runs now" : "", fallback ? "declared fallback" : "", missing.length ? `has no port ${missing.join(", ")}` : ""];
    const rank = (missing.length ? 4 : 0) + (same ? 2 : 0) + (fallback ? -1 : 0);
    return { name, fits: !missing.length, words: words.filter(Boolean).join(", "), rank };
  });
  return found.sort((a, b) => a.rank - b.rank || (a.name < b.name ? -1 : 1));
}

/** @param {any} component @returns {Set<string>} */
function ports(component) {
  const outputs = component.outputs ?? [];
  return new Set([...Object.keys(component.inputs ?? {}), ...(Array.isArray(outputs) ? outputs : Object.keys(outputs))]);
}
