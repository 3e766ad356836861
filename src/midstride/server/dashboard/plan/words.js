/**
 * Plans and outcomes in words: the sentences of the command line (cli/render.py), so that both say the same.
 *
 * @module
 */

/** @typedef {Api.PlanPreview["steps"][number]} Step */

/** A duration with three significant digits or so. @param {number | null | undefined} value in seconds */
export function duration(value) {
  if (value === null || value === undefined) return "unknown";
  if (value >= 10) return `${value.toFixed(1)} s`;
  if (value >= 1) return `${value.toFixed(2)} s`;
  return `${Math.round(value * 1000)} ms`;
}

/** @param {number} value @returns {string} three significant digits */
export function figure(value) {
  return String(Number(value.toPrecision(3)));
}

/** @param {string[]} words @returns {string} as "a, b and c" */
export function listed(words) {
  return [words.slice(0, -1).join(", "), words.at(-1)].filter(Boolean).join(" and ");
}

/** @param {unknown} value of a parameter @returns {string} */
function written(value) {
  if (typeof value === "string") return `'${value}'`;
  if (typeof value === "boolean") return value ? "True" : "False";
  if (Array.isArray(value)) return `[${value.map(written).join(", ")}]`;
  if (value !== null && typeof value === "object" && "float" in value) return String(value.float);
  return String(value);
}

/** @param {Step} step of a plan @returns {string} what it does */
export function stepText(step) {
  switch (step.action) {
    case "create":
      return `create ${step.instance} (${step.component})${step.host ? ` on ${step.host}` : ""}`;
    case "remove":
      return `remove ${step.instance}`;
    case "attach":
      return `attach ${step.port} to ${step.topic}`;
    case "detach":
      return `detach ${step.port} from ${step.topic}`;
    case "degrade":
    case "upgrade": {
      const modes = Object.entries(step.modes).map(([name, each]) => `${name} from ${each.from} to ${each.to}`);
      return `${step.action} ${modes.join(", ") || "nothing"}`;
    }
    case "handover": {
      const swaps = step.swaps.map((each) => `${each.topic} from ${each.old} to ${each.new}`);
      return `hand over ${swaps.join(", ") || "nothing"}`;
    }
    case "set": {
      const values = Object.entries(step.parameters ?? {}).sort(([a], [b]) => (a < b ? -1 : 1));
      return `set ${values.map(([name, value]) => `${name} = ${written(value)}`).join(", ")} on ${step.instance}`;
    }
    default:
      return String(/** @type {{action: string}} */ (step).action);
  }
}

/** How long a step takes, with the range that was measured where it is wide. @param {Step} step */
export function about(step) {
  return withRemarks(step.seconds, spread(step));
}

/** @param {{between?: [number, number]}} document @returns {string[]} */
function spread(document) {
  const [shortest, longest] = document.between ?? [0, 0];
  return longest - shortest < 0.1 ? [] : [`${duration(shortest)} to ${duration(longest)}`];
}

/** @param {number} planned in seconds @param {string[]} remarks */
function withRemarks(planned, remarks) {
  return duration(planned) + (remarks.length ? ` (${remarks.join("; ")})` : "");
}

/** How long a plan takes as it is carried out (s). Earlier reports only have the sum of its steps. @param {import("../store.js").Plan} plan */
export function plannedSeconds(plan) {
  return plan.duration ?? plan.seconds;
}

/** The same in words, with its range; beside it the sum of its steps where they overlap. @param {import("../store.js").Plan} plan */
export function aboutPlan(plan) {
  const planned = plannedSeconds(plan);
  const inSequence = duration(planned) === duration(plan.seconds) ? [] : [`${duration(plan.seconds)} one step after another`];
  return withRemarks(planned, [...spread(plan), ...inSequence]);
}

/** @param {Api.LevelShift} shift */
function lowered(shift) {
  const { functionality, from, to } = shift;
  return to === null ? `no instance serves ${functionality}` : `${functionality} is in mode ${to} instead of ${from}`;
}

/** The mode that a role's functionality enters in a step. @param {Step | undefined} step @param {string} functionality */
export function modeEntered(step, functionality) {
  const dot = functionality.lastIndexOf(".");
  const [role, name] = [functionality.slice(0, dot), functionality.slice(dot + 1)];
  for (const [ref, modes] of Object.entries(step && "modes" in step ? step.modes : {})) {
    const end = ref.lastIndexOf(".");
    const instance = ref.slice(0, end);
    const suffix = instance.startsWith(`${role}_`) ? instance.slice(role.length + 1) : "";
    if (ref.slice(end + 1) === name && (instance === role || /^\d+$/.test(suffix))) return modes.to;
  }
  return null;
}

/**
 * What degrades on the way, how far, for how long and why.
 *
 * @param {import("../store.js").Plan} plan
 * @returns {{functionality: string, head: string, because: string[], already: boolean}[]} `already`: before the first step
 */
export function falls(plan) {
  return (plan.degradations ?? []).map((fall) => {
    const name = fall.functionality;
    if (!fall.from_step) return already(plan, fall);
    const where = fall.to_step === null ? `from step ${fall.from_step} on` : `steps ${fall.from_step} to ${fall.to_step}`;
    const mode = modeEntered(plan.steps[fall.from_step - 1], name);
    let depth = mode ? ` to ${mode}` : "";
    if (mode && fall.unserved_from_step !== null) depth += `, unserved from step ${fall.unserved_from_step} on,`;
    return {
      functionality: name,
      head: `${name}${depth} for about ${duration(fall.seconds)} (${where})`,
      because: [fall.because, ...(fall.forced_by ?? []), ...alternatives(plan, name)],
      already: false,
    };
  });
}

/** How long a functionality remains below that is below before the first step. @param {import("../store.js").Plan} plan @param {Api.Degradation} fall */
function already(plan, fall) {
  const name = fall.functionality;
  const until = fall.to_step === null ? "throughout" : `until step ${fall.to_step}`;
  const unserved = fall.unserved_from_step ? `, unserved from step ${fall.unserved_from_step} on` : "";
  return {
    functionality: name,
    head: `${name} for about ${duration(fall.seconds)} more (${until}${unserved})`,
    because: [...(fall.forced_by ?? []), ...alternatives(plan, name)],
    already: true,
  };
}

/** @param {import("../store.js").Plan} plan @param {string} functionality */
function alternatives(plan, functionality) {
  const found = (plan.alternatives ?? []).filter((each) => each.functionality === functionality);
  return found.map(alternative);
}

/** What it would cost to keep a functionality. @param {Api.Alternative} each */
function alternative(each) {
  if (each.impossible !== null) return `It cannot be kept at ${each.kept_at}: ${each.impossible}`;
  const instead = each.degraded.length ? listed(each.degraded) : "nothing";
  const cost = `the disruption would be ${figure(each.disruption ?? 0)}`;
  return `To keep it at ${each.kept_at}, ${cost}: ${instead} would degrade instead`;
}

/**
 * What is in another mode afterwards, for good.
 *
 * @param {import("../store.js").Plan} plan
 * @returns {{worse: string[], better: string[]}}
 */
export function afterwards(plan) {
  const shifts = plan.level_shifts ?? [];
  return {
    worse: shifts.filter((each) => each.levels > 0).map(lowered),
    better: shifts
      .filter((each) => each.levels <= 0)
      .map((each) => `${each.functionality}, from ${each.from ?? "unserved"} to ${each.to ?? "unserved"}`),
  };
}

/** The cost of a plan, and whether its disruption is proved minimal. @param {import("../store.js").Plan} plan */
export function cost(plan) {
  let bound = plan.proved_minimal ? "proved minimal" : `at least ${figure(plan.lower_bound ?? 0)}`;
  if (plan.proof_space === "detours") bound += ", with detours";
  const { worse } = afterwards(plan);
  let disruption = `Disruption ${figure(plan.disruption)} weighted functionality-seconds`;
  disruption += worse.length ? ` on the way (${bound}), and afterwards ${worse.join(", ")}` : ` (${bound})`;
  return `${disruption}; takes about ${aboutPlan(plan)}; strategy ${plan.strategy}.`;
}

/**
 * Why a plan may not be carried out now, and what changes require; of the running system.
 *
 * @param {import("../store.js").Plan} plan
 * @returns {{kind: "bad" | "", words: string}[]}
 */
export function permission(plan) {
  const required = (plan.requires ?? []).map(({ requirement, holds, because }) => ({
    kind: /** @type {"bad" | ""} */ (holds ? "" : "bad"),
    words: `Required: ${requirement}: ${holds ? "it holds" : because}.`,
  }));
  if (!plan.forbidden) return required;
  return [{ kind: "bad", words: `It may not be carried out now: ${plan.forbidden}` }, ...required];
}

/** What a plan does besides its steps, and to values that were set at run time. @param {import("../store.js").Plan} plan @returns {string[]} */
export function remarks(plan) {
  const own = Object.entries(plan.own_state ?? {}).map(([name, because]) => `${name} starts with its own state: ${because}.`);
  return [...(plan.remarks ?? []), ...(plan.parameters ?? []).map((each) => each.words), ...own];
}
