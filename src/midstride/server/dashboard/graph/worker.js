/**
 * The worker that lays out graphs: elkjs (vendor/elkjs, unmodified). index.html loads this module first, so that the worker
 * reads its large program while the page still loads.
 *
 * @module
 */

import "../vendor/elkjs/elk-api.js";

const workerUrl = new URL("../vendor/elkjs/elk-worker.min.js", import.meta.url).href;

/** @type {{layout: (graph: any) => Promise<any>}} */
export const elk = new /** @type {any} */ (globalThis).ELK({ workerUrl, algorithms: ["layered"] });
