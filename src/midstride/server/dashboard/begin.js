/*
 * Begins what takes longest before anything else of the page is read: the worker that lays out graphs has a large program.
 */

(() => {
  const started = new Worker("vendor/elkjs/elk-worker.min.js");
  /** @type {any} */ (globalThis).midstrideWorker = function () {
    return started;
  };
})();
