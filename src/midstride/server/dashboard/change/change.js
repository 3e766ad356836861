/**
 * The panel of changes: choose one, see its plan, rehearse it, carry it out and watch it, and go back.
 *
 * Every control sends the request that the command beside it sends.
 *
 * @module
 */

import { ApiError, download } from "../api.js";
import { h, replace } from "../dom.js";
import { comparison, plansOfAll } from "./compare.js";
import { listenForFiles } from "./drop.js";
import { Form } from "./form.js";
import { setParameter } from "./parameter.js";
import { command, outcomeParts, planParts } from "./parts.js";
import { NOTHING, changeCommand, comparable, complete, planCommand, rehearsalCommand, request, title } from "./request.js";
import { rehearsal } from "./rehearse.js";
import { earlierVersions } from "./versions.js";
import { watch } from "./watch.js";

/** How many runs a rehearsal has. */
const SEEDS = 20;

/**
 * @param {HTMLElement} element
 * @param {import("../panels.js").Context} context
 */
export function mountChange(element, context) {
  new ChangePanel(element, context);
}

/** @param {Api.DiagnosticReport} diagnostic @returns {string} as `midstride check` prints it */
function inWords(diagnostic) {
  const { file, line, column, severity, code, message, help } = diagnostic;
  const head = `${file}:${line}:${column}: ${severity} [${code}]: ${message}`;
  return help ? `${head}\n  help: ${help}` : head;
}

class ChangePanel {
  /** @type {import("./request.js").Choice} */ #choice = NOTHING;
  /** @type {Api.SpecificationForm | null} */ #specification = null;
  /** @type {[number, string][]} */ #versions = [];
  /** @type {(import("../store.js").Plan & {revision: number}) | null} */ #plan = null;
  /** @type {import("../store.js").Plan | null} */ #shown = null; // the plan that is on the graph
  #mine = false; // a change that this page has asked for is in progress
  #own = 0; // when that change began
  #watched = 0; // when the change of another client began that is shown until it is closed
  #drawn = "";
  #generation = 0;

  /**
   * @param {HTMLElement} element
   * @param {import("../panels.js").Context} context
   */
  constructor(element, context) {
    this.context = context;
    this.form = new Form((change) => this.#choose(change));
    this.commands = h("div");
    this.actions = h("div", { class: "change-actions" });
    this.result = h("div", { class: "change-result", role: "status" });
    this.chooser = /** @type {HTMLDetailsElement} */ (
      h("details", { class: "change-chooser", open: true }, h("summary", { class: "panel-title" }, "Change"))
    );
    this.chooser.append(this.form.element, this.actions, this.commands, this.form.drop);
    this.progress = h("div", { class: "change-progress" });
    replace(element, this.progress, this.chooser, this.result);
    listenForFiles(this.form.file, (file, text) => this.#dropped(file, text));
    const { store } = context;
    store.subscribe(["change", "time"], () => this.#follow());
    store.subscribe(["revision", "phase"], () => this.#load());
    store.subscribe(["selection"], () => this.#selected());
    this.#load();
    this.#drawActions();
    this.#follow();
  }

  get #width() {
    return Math.max(this.chooser.clientWidth || 340, 240);
  }

  // -- choosing -----------------------------------------------------------------------------------------

  async #load() {
    const { ask, store } = this.context;
    if (!store.live || store.live.phase !== "up") return;
    try {
      this.#specification = await ask("GET", "/specification");
      this.#offer();
      this.#versions = earlierVersions(await ask("GET", "/history?latest=100"));
      this.#offer();
    } catch {
      // asked again with the next revision; a lost connection is shown at the top
    }
  }

  #offer() {
    const { store } = this.context;
    const parameters = (/** @type {string} */ node) => Object.values(store.live?.instances ?? {}).find((each) => each.role === node)?.parameters ?? [];
    this.form.offer(this.#specification, this.#choice, { versions: this.#versions, parameters });
    this.#choice = { ...this.#choice, ...this.form.settled };
    this.#drawActions();
    if (this.#choice.kind === "rollback" && this.#choice.to === null && this.#choice.version !== null) this.#fetchVersion(this.#choice.version);
  }

  /** @param {number} version */
  async #fetchVersion(version) {
    try {
      const found = await this.context.ask("GET", `/specification/earlier?version=${version}`);
      if (this.#choice.kind === "rollback" && this.#choice.version === version) this.#choose({ to: found.specification });
    } catch (error) {
      this.#refusedBy(error);
    }
  }

  #selected() {
    const { store } = this.context;
    const role = store.selected === null ? null : store.live?.instances[store.selected]?.role;
    if (!role || this.#plan || this.#mine || ["add", "rollback"].includes(this.#choice.kind)) return;
    this.#choose({ kind: this.#choice.kind === "apply" ? "replace" : this.#choice.kind, node: role, component: "", parameter: "" });
  }

  /** @param {Partial<import("./request.js").Choice>} change */
  #choose(change) {
    this.#choice = { ...this.#choice, ...change };
    this.#discard();
    this.#offer();
  }

  /** @param {string} file @param {string | null} text null: it is too large */
  async #dropped(file, text) {
    const { ask } = this.context;
    const mine = ++this.#generation;
    this.chooser.open = true;
    if (text === null) {
      this.#refused(`${file} is too large:`, "a file that is sent to the manager may have 1 MB; save it on the robot, and apply it there with `midstride apply`");
      return;
    }
    replace(this.result, h("p", { class: "muted" }, `Checking ${file} …`));
    try {
      const checked = await ask("POST", "/check", { text, name: file });
      if (mine !== this.#generation) return;
      if (!checked.ok) {
        this.#refused(`${file} has errors:`, checked.diagnostics.map(inWords).join("\n"));
        return;
      }
      this.#choose({ kind: "apply", to: checked.request.to, file });
      await this.#planIt();
    } catch (error) {
      if (mine === this.#generation) this.#refusedBy(error);
    }
  }

  #drawActions() {
    const { say } = this.context;
    const ready = complete(this.#choice);
    const planned = this.#plan !== null && this.#plan.steps.length > 0;
    const button = (/** @type {string} */ words, /** @type {() => void} */ act, kind = "", on = true) =>
      h("button", { class: `button ${kind}`, type: "button", disabled: !on, onclick: act }, words);
    const setting = this.#choice.kind === "param";
    const both = ready && comparable(this.#choice);
    replace(
      this.actions,
      ...(setting ? [button("Set", () => this.#setParameter(), "primary", ready)] : []),
      !setting && button("Plan", () => this.#planIt(), planned ? "" : "primary", ready),
      !setting && button("Compare strategies", () => this.#compare(), "", both),
      !setting && button("Rehearse", () => this.#rehearse(), "", both),
      planned && button("Execute", () => this.#execute(), "primary", !this.#mine),
      this.#plan && button("Discard", () => this.#discard(), "danger"),
    );
    const lines = !ready
      ? []
      : planned || setting
        ? [changeCommand(this.#choice)]
        : both
          ? [
              planCommand(this.#choice, ["--explain"]),
              planCommand(this.#choice, ["--compare"]),
              rehearsalCommand(this.#choice, "FILE", SEEDS),
            ]
          : [this.#choice.kind === "rollback" ? planCommand(this.#choice) : changeCommand(this.#choice)];
    replace(this.commands, ...lines.map((line) => command(line, say)));
  }

  // -- the plan -----------------------------------------------------------------------------------------

  async #planIt() {
    const mine = ++this.#generation;
    replace(this.result, h("p", { class: "muted" }, "Planning …"));
    try {
      const plan = await this.context.ask("POST", "/plan", { ...request(this.#choice), explain: true });
      if (mine !== this.#generation) return;
      this.#plan = plan;
      this.#ghosts(plan);
      replace(this.result, h("h2", { class: "panel-title" }, `Plan: ${title(this.#choice)}`), ...planParts(plan, this.#width));
    } catch (error) {
      if (mine === this.#generation) this.#refusedBy(error);
    }
    this.#drawActions();
  }

  async #compare() {
    const mine = ++this.#generation;
    replace(this.result, h("p", { class: "muted" }, "Planning with each strategy …"));
    const plans = await plansOfAll(this.context.ask, this.#choice);
    if (mine !== this.#generation) return;
    const pick = (/** @type {string} */ strategy) => {
      this.#choose({ strategy });
      this.#planIt();
    };
    replace(this.result, h("h2", { class: "panel-title" }, `Strategies: ${title(this.#choice)}`), ...comparison(plans, this.#width, pick));
  }

  async #rehearse() {
    const mine = ++this.#generation;
    replace(this.result, h("p", { class: "muted" }, `Rehearsing in the simulator, ${SEEDS} runs with faults …`));
    try {
      const found = await this.context.ask("POST", "/rehearsal", { request: request(this.#choice), seeds: SEEDS });
      if (mine === this.#generation) replace(this.result, ...rehearsal(found, title(this.#choice)));
    } catch (error) {
      if (mine === this.#generation) this.#refusedBy(error);
    }
  }

  async #setParameter() {
    const mine = ++this.#generation;
    try {
      const shown = await setParameter(this.context.ask, this.#choice);
      if (mine === this.#generation) replace(this.result, ...shown);
    } catch (error) {
      if (mine === this.#generation) this.#refusedBy(error, "It may be set all the same.");
    }
  }

  #discard() {
    this.#generation += 1;
    this.#plan = null;
    replace(this.result);
    if (!this.#running()) this.#ghosts(null);
    this.#drawActions();
  }

  /** @param {import("../store.js").Plan | null} plan @param {number | null} [step] */
  #ghosts(plan, step = null) {
    this.#shown = plan;
    this.context.graph.ghosts(plan, { step });
  }

  /** @param {unknown} error @param {string} [otherwise] what may be so all the same where no answer has come */
  #refusedBy(error, otherwise = "") {
    const unexpected = !(error instanceof ApiError);
    const { name, message } = /** @type {Error} */ (error);
    if (unexpected && name === "AbortError") return;
    const unanswered = !unexpected && ["Unreachable", "NoManager"].includes(error.kind);
    if (unanswered) this.#refused("No answer:", otherwise ? `${message}. ${otherwise}` : message);
    else this.#refused(unexpected ? "The page has failed:" : "Refused:", message);
  }

  /** @param {string} head @param {string} words those of the planner, in full */
  #refused(head, words) {
    replace(this.result, h("div", { class: "banner", "data-kind": "bad", role: "alert" }, h("strong", {}, `✕ ${head}`), h("p", { class: "refusal" }, words)));
  }

  // -- carrying out -------------------------------------------------------------------------------------

  async #execute() {
    const { plan, choice } = { plan: this.#plan, choice: this.#choice };
    if (plan === null) return;
    await this.#carryOut(request(choice), plan.revision, `dashboard: ${title(choice)}`, choice);
  }

  /**
   * @param {Record<string, unknown>} asked
   * @param {number} expected the revision that the plan was made for
   * @param {string} by
   * @param {import("./request.js").Choice} choice
   */
  async #carryOut(asked, expected, by, choice) {
    const { ask } = this.context;
    this.#mine = true;
    this.#watched = 0;
    this.#drawActions();
    replace(this.result);
    this.chooser.open = false;
    try {
      const outcome = await ask("POST", "/change", {
        request: asked,
        expected,
        verify: choice.verify,
        by: by.slice(0, 200),
        ...(choice.file ? { file: choice.file } : {}),
      });
      this.#ended(outcome, by.replace("dashboard: ", ""));
    } catch (error) {
      this.#refusedBy(error, "The manager may carry the change out all the same: its events show how it ends.");
    } finally {
      this.#mine = false;
      this.#plan = null;
      this.#follow();
      this.#drawActions();
    }
  }

  /** @param {Api.Outcome} outcome @param {string} what */
  #ended(outcome, what) {
    const { say } = this.context;
    this.#ghosts(null);
    const changed = outcome.outcome === "done";
    const close = () => {
      this.chooser.open = true;
      replace(this.result);
      this.#follow();
    };
    replace(
      this.result,
      h("h2", { class: "panel-title" }, what),
      ...outcomeParts(outcome, outcome.plan, this.#width),
      h(
        "div",
        { class: "change-actions" },
        changed && h("button", { class: "button", type: "button", onclick: () => this.#rollBack() }, "Roll back"),
        outcome.outcome !== "refused" && h("button", { class: "button", type: "button", onclick: () => this.#report() }, "Save report"),
        h("button", { class: "button", type: "button", onclick: close }, "Close"),
      ),
      changed && command("midstride rollback", say),
      outcome.outcome !== "refused" && command("midstride report -o change.html", say),
    );
  }

  async #rollBack() {
    const { ask } = this.context;
    try {
      const earlier = await ask("GET", "/specification/earlier");
      const what = `rollback to version ${earlier.version}`;
      const asked = { to: earlier.specification };
      const plan = await ask("POST", "/plan", asked);
      this.#ghosts(plan);
      await this.#carryOut(asked, plan.revision, `dashboard: ${what}`, { ...NOTHING, kind: "apply" });
    } catch (error) {
      this.#refusedBy(error);
    }
  }

  async #report() {
    try {
      await download("/report", `${this.context.store.live?.system ?? "system"}-change.html`);
    } catch (error) {
      this.#refusedBy(error);
    }
  }

  // -- watching -----------------------------------------------------------------------------------------

  #running() {
    const change = this.context.store.live?.change ?? null;
    return change !== null && change.state !== "ended";
  }

  /** A change in progress is shown, whoever has asked for it; its steps are on the graph. */
  #follow() {
    const { store } = this.context;
    const change = store.live?.change ?? null;
    const running = this.#running();
    if (change !== null && running) {
      if (this.#mine) this.#own = change.began; // its outcome is shown by the answer to the request
      if (change.began !== this.#own) this.#watched = change.began;
    }
    const shown = change !== null && (running || change.began === this.#watched) ? change : null;
    const key = shown ? JSON.stringify([shown.began, shown.state, shown.steps, shown.swaps.length]) : "";
    if (key === this.#drawn) return;
    this.#drawn = key;
    if (shown === null) {
      replace(this.progress);
      if (this.#shown !== null && this.#plan === null) this.#ghosts(null);
      return;
    }
    const close = () => {
      this.#watched = 0;
      this.#follow();
    };
    const button = h("button", { class: "button", type: "button", onclick: close }, "Close");
    replace(this.progress, ...watch(shown, this.#width), running ? null : h("div", { class: "change-actions" }, button));
    if (running && shown.plan) this.#ghosts(shown.plan, shown.index);
    else if (this.#plan === null) this.#ghosts(null);
  }
}
