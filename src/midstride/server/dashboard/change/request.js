/**
 * A change as a request to the manager, and as the command that asks for the same.
 *
 * @module
 */

/**
 * `role`, `topics` (by port, separated by spaces) and `values` (of parameters, as text) are those of a node to add;
 * `version` is the one to go back to, and `to` its specification, or that of a file; `parameter` is set to `value`.
 *
 * @typedef {"replace" | "restart" | "add" | "remove" | "rollback" | "param" | "apply"} Kind
 * @typedef {{kind: Kind, node: string, component: string, role: string, topics: Record<string, string>,
 *   values: Record<string, string>, version: number | null, parameter: string, value: string, to: Api.SpecificationForm | null,
 *   file: string | null, strategy: string, detours: boolean, declared: boolean, others: boolean, same: boolean,
 *   verify: boolean}} Choice
 */

import { valueText } from "../dom.js";

export const STRATEGIES = ["minimal", "paper", "quiesce", "stop"];

/** @type {Choice} */
export const NOTHING = {
  kind: "replace",
  node: "",
  component: "",
  role: "",
  topics: {},
  values: {},
  version: null,
  parameter: "",
  value: "",
  to: null,
  file: null,
  strategy: "minimal",
  detours: false,
  declared: false,
  others: false,
  same: false,
  verify: false,
};

/** @param {Choice} choice @returns {boolean} whether there is something to plan, or to set */
export function complete(choice) {
  switch (choice.kind) {
    case "apply":
    case "rollback":
      return choice.to !== null;
    case "add":
      return choice.role !== "" && choice.component !== "";
    case "param":
      return choice.node !== "" && choice.parameter !== "" && choice.value !== "";
    default:
      return choice.node !== "" && (choice.kind !== "replace" || choice.component !== "");
  }
}

/** @param {Choice} choice @returns {boolean} whether commands can compare its strategies, and rehearse it */
export function comparable(choice) {
  return choice.kind !== "rollback" && !(choice.kind === "add" && filled(choice.values).length > 0);
}

/** @param {Choice} choice @returns {boolean} whether a node keeps what was set at run time, unless that is not wanted */
export function keepsParameters(choice) {
  return !["add", "remove", "param"].includes(choice.kind);
}

/**
 * @param {Api.SpecificationForm | null} specification
 * @param {Choice} choice
 * @returns {boolean} whether a node that is replaced is in a container, so that it may start in the process that it is in
 */
export function mayKeepProcess(specification, choice) {
  if (choice.kind === "apply") return Object.keys(specification?.containers ?? {}).length > 0;
  return ["replace", "restart"].includes(choice.kind) && specification?.nodes?.[choice.node]?.container !== undefined;
}

/** @param {Choice} choice @returns {Record<string, unknown>} the document of POST /plan, and `request` of POST /change */
export function request(choice) {
  /** @type {Record<string, unknown>} */
  const document = { strategy: choice.strategy };
  if (choice.detours && choice.strategy === "minimal") document.detours = true;
  if (choice.declared && keepsParameters(choice)) document.declared_parameters = true;
  if (choice.others) document.with_other_nodes = true;
  if (choice.same) document.same_process = true;
  if (choice.kind === "replace") document.replace = [[choice.node, choice.component]];
  else if (choice.kind === "add") document.add = [newNode(choice)];
  else if (choice.kind === "apply" || choice.kind === "rollback") document.to = choice.to;
  else document[choice.kind] = [choice.node];
  return document;
}

/** @param {Choice} choice @returns {Record<string, unknown>} what `midstride add` makes of its arguments */
function newNode({ role, component, topics, values }) {
  const attachments = filled(topics).map(([port, names]) => [port, names.split(/\s+/)]);
  const parameters = filled(values).map(([name, text]) => [name, valueOf(text)]);
  return { role, component, attachments: Object.fromEntries(attachments), parameters: Object.fromEntries(parameters) };
}

/** @param {Record<string, string>} texts @returns {[string, string][]} those that are not empty */
function filled(texts) {
  return Object.entries(texts).flatMap(([name, text]) => (text.trim() === "" ? [] : [/** @type {[string, string]} */ ([name, text.trim()])]));
}

const NOT_FINITE = /(?<![^[,\s])\+?(-?)\.(inf|nan)(?![^\],\s])/gi;

/** The value of a parameter: JSON, with YAML's `.inf` and `.nan`, or else a string. @param {string} text */
export function valueOf(text) {
  /** @type {(match: string, sign: string, word: string) => string} */
  const form = (_, sign, word) => JSON.stringify({ float: word.toLowerCase() === "nan" ? "nan" : `${sign}inf` });
  try {
    return JSON.parse(text.includes('"') ? text : text.replace(NOT_FINITE, form));
  } catch {
    return text;
  }
}

/** A word as a shell takes it. @param {string} text */
function quoted(text) {
  return /^[\w@%+=:,./-]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`;
}

/** @param {Choice} choice @returns {string[]} the words after `midstride` that name the change */
function words(choice) {
  switch (choice.kind) {
    case "replace":
      return ["replace", choice.node, choice.component];
    case "add":
      return ["add", ...added(choice), ...filled(choice.values).flatMap(([name, text]) => ["--param", `${name}=${yaml(valueOf(text))}`])];
    case "rollback":
      return ["rollback", String(choice.version)];
    case "param":
      return ["param", "set", choice.node, choice.parameter, yaml(valueOf(choice.value.trim()))];
    case "apply":
      return ["apply", choice.file ?? "NEW.stride", "--keep-code"];
    default:
      return [choice.kind, choice.node];
  }
}

/** @param {Choice} choice @returns {string[]} as "second", "Listener", "in=/chatter" */
function added({ role, component, topics }) {
  const attachments = filled(topics).flatMap(([port, names]) => names.split(/\s+/).map((name) => `${port}=${name}`));
  return [role, component, ...attachments];
}

/** A value as `param set` and `add --param` read it: YAML has other strings without quotes, and no `1e-7`. @param {unknown} value */
function yaml(value) {
  if (typeof value === "number") return String(value).replace(/^(-?\d+)e/, "$1.0e");
  if (value !== null && typeof value === "object" && JSON.stringify(value).includes('"float"')) return valueText(value);
  const plain = typeof value === "string" && /^[A-Za-z/][\w./-]*$/.test(value) && !/^(y|n|yes|no|on|off|true|false|null)$/i.test(value);
  return plain ? String(value) : JSON.stringify(value);
}

/** @param {Choice} choice */
function options(choice) {
  const found = choice.strategy === "minimal" ? [] : ["--strategy", choice.strategy];
  if (choice.detours && choice.strategy === "minimal") found.push("--detours");
  if (choice.declared && keepsParameters(choice)) found.push("--declared-parameters");
  if (choice.others) found.push("--with-other-nodes");
  if (choice.same) found.push("--same-process");
  return found;
}

/** @param {string[]} found */
function command(found) {
  return ["midstride", ...found.map(quoted)].join(" ");
}

/** @param {Choice} choice @returns {string} the command that makes the change */
export function changeCommand(choice) {
  if (choice.kind === "param") return command(words(choice));
  return command([...words(choice), ...options(choice), ...(choice.verify ? ["--verify"] : [])]);
}

/** @param {Choice} choice @param {string[]} [more] @returns {string} the command that shows the plan */
export function planCommand(choice, more = []) {
  if (choice.kind === "rollback") return command([...words(choice), ...options(choice), "--dry-run"]);
  /** @type {Record<string, string[]>} */
  const change = {
    replace: ["--replace", `${choice.node}=${choice.component}`],
    restart: ["--restart", choice.node],
    add: ["--add", added(choice).join(" ")],
    remove: ["--remove", choice.node],
    apply: ["--to", choice.file ?? "NEW.stride"],
  };
  return command(["plan", ...change[choice.kind], ...options(choice), ...more]);
}

/** @param {Choice} choice @param {string} file @param {number} seeds @returns {string} the command that rehearses it */
export function rehearsalCommand(choice, file, seeds) {
  const plan = planCommand({ ...choice, others: false, same: false }).split(" ").slice(2).join(" ");
  return `midstride simulate ${quoted(file)} ${plan} --seeds ${seeds}`;
}

/** @param {Choice} choice @returns {string} the change in a few words, as the history has it */
export function title(choice) {
  switch (choice.kind) {
    case "replace":
      return `replace ${choice.node} with ${choice.component}`;
    case "add":
      return `add ${choice.role} (${choice.component})`;
    case "rollback":
      return `rollback to version ${choice.version}`;
    case "apply":
      return `apply ${choice.file ?? "a specification"}`;
    default:
      return `${choice.kind} ${choice.node}`;
  }
}

/**
 * The components that may take a node's place: what it falls back to first, then those with all its ports, then others.
 *
 * @param {Api.SpecificationForm | null} specification
 * @param {string} role
 * @returns {{name: string, fits: boolean, words: string}[]}
 */
export function replacements(specification, role) {
  const node = specification?.nodes?.[role];
  if (!node) return [];
  const needed = Object.keys(node.attachments ?? {});
  const found = Object.entries(specification?.components ?? {}).map(([name, component]) => {
    const missing = needed.filter((port) => !ports(component).has(port));
    const fallback = node.respawn?.fallback === name;
    const same = node.component === name;
    const words = [same ? "runs now" : "", fallback ? "declared fallback" : "", missing.length ? `has no port ${missing.join(", ")}` : ""];
    const rank = (missing.length ? 4 : 0) + (same ? 2 : 0) + (fallback ? -1 : 0);
    return { name, fits: !missing.length, words: words.filter(Boolean).join(", "), rank };
  });
  return found.sort((a, b) => a.rank - b.rank || (a.name < b.name ? -1 : 1));
}

/** @param {Api.ComponentForm} component @returns {Set<string>} */
function ports(component) {
  return new Set([...Object.keys(component.inputs ?? {}), ...(component.outputs ?? [])]);
}
