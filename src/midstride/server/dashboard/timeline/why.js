/**
 * Why a functionality was lowered: in words, and on the graph.
 *
 * @module
 */

import { clock, h, replace } from "../dom.js";
import { namesIn } from "../graph/names.js";

export class Why {
  /** @param {import("./timeline.js").Context} context */
  constructor(context) {
    this.context = context;
    this.element = h("div", { class: "timeline-why", role: "region", "aria-label": "Why", hidden: true });
    this.element.addEventListener("keydown", (event) => {
      if (event.key === "Escape") this.close();
    });
  }

  /**
   * The chain of reasons of a stretch that lasts, as the manager sees it now; of a past one, what its component said.
   *
   * @param {import("./intervals.js").Row} row
   * @param {import("./intervals.js").Segment} segment
   */
  async show(row, segment) {
    const { store, ask, graph, say } = this.context;
    const { instance, functionality, mode, because, reflex, began } = segment.interval;
    const name = `${instance}.${functionality}`;
    /** @type {string[]} */ let chain = [];
    if (segment.open && store.time.at === null && !this.context.fixed) {
      try {
        const why = await ask("GET", `/why?functionality=${encodeURIComponent(name)}`);
        const next = (why.remedies ?? []).map((/** @type {string} */ each) => `next: ${each}`);
        chain = [...(why.because ? [why.because] : []), ...why.chain, ...next];
      } catch (error) {
        say(/** @type {Error} */ (error).message, { kind: "bad", seconds: 6 });
      }
    }
    const reasons = chain.length ? chain : because ? [because] : ["Its component gave no reason."];
    const title = `${row.name} in mode ${mode} from ${clock(began)}${reflex ? ", by its local reflex" : ""}`;
    const command = `midstride why ${name}`;
    replace(
      this.element,
      h("div", { class: "why-title" }, h("strong", {}, title), h("code", { class: "mono muted" }, command), h("button", { class: "button quiet", type: "button", "aria-label": "Close", onclick: () => this.close() }, "✕")),
      h("ol", { class: "why-chain" }, ...reasons.flatMap((each) => each.split("\n")).map((each) => h("li", {}, each))),
    );
    this.element.hidden = false;
    if (store.view === null) return;
    const names = namesIn([name, instance, ...reasons], store.view);
    graph.highlight(names.length ? names : null); // it may be about what is not there any more
    if (instance in store.view.instances) graph.reveal(instance);
  }

  close() {
    this.element.hidden = true;
    this.context.graph.highlight(null);
  }
}
