/**
 * The worker that lays out graphs: elkjs (vendor/elkjs, unmodified).
 *
 * `midstrideWorker` makes it: begin.js has started it by now. A report from disk can start none, and brings one along that
 * runs in the page.
 *
 * @module
 */

import "../vendor/elkjs/elk-api.js";

const { ELK, midstrideWorker } = /** @type {any} */ (globalThis);

/** @type {{layout: (graph: any) => Promise<any>}} */
export const elk = new ELK({ workerFactory: () => new midstrideWorker(), algorithms: ["layered"] });
