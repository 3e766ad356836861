/**
 * The worker that lays out graphs: elkjs (vendor/elkjs, unmodified). index.html loads this module first, so that the worker
 * reads its large program while the page still loads.
 *
 * @module
 */

import "../vendor/elkjs/elk-api.js";

const { ELK, midstrideWorker } = /** @type {any} */ (globalThis);
const workerUrl = new URL("../vendor/elkjs/elk-worker.min.js", import.meta.url).href;
// A report from disk can start no worker: it brings one along that runs in the page.
const worker = midstrideWorker ? { workerFactory: () => new midstrideWorker() } : { workerUrl };

/** @type {{layout: (graph: any) => Promise<any>}} */
export const elk = new ELK({ ...worker, algorithms: ["layered"] });
