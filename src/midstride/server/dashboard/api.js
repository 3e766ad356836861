/**
 * The manager's HTTP API. The page has no other way in: every control is a request that the command line sends too.
 *
 * @module
 */

const BASE = "/api/v1";
const TOKEN = "midstride-token";

/** An answer that is an error, or none. `kind` is the API's, "Unreachable" where nothing answered. */
export class ApiError extends Error {
  /**
   * @param {string} kind
   * @param {string} message
   * @param {number} status 0 where nothing answered
   */
  constructor(kind, message, status) {
    super(message);
    this.name = "ApiError";
    this.kind = kind;
    this.status = status;
  }
}

/** A token in the address (`#token=…`) is kept for this tab, and removed from the address so that it is not shared. */
function token() {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  try {
    if (given !== null) sessionStorage.setItem(TOKEN, given);
    if (given !== null) history.replaceState(null, "", location.pathname + location.search);
    return given ?? sessionStorage.getItem(TOKEN);
  } catch {
    return given; // storage is switched off in this browser
  }
}

const bearer = token();

/**
 * A request, with what every request carries.
 *
 * @param {string} path below the API's base, as "/plan"
 * @param {RequestInit} [options]
 * @returns {Promise<Response>} an answer that is no error
 * @throws {ApiError}
 */
export async function request(path, options = {}) {
  const headers = new Headers(options.headers);
  if (bearer !== null) headers.set("Authorization", `Bearer ${bearer}`);
  let response;
  try {
    response = await fetch(BASE + path, { cache: "no-store", ...options, headers });
  } catch (error) {
    if (options.signal?.aborted) throw error;
    throw new ApiError("Unreachable", "the manager cannot be reached", 0);
  }
  if (!response.ok) throw await refusal(response);
  return response;
}

/**
 * @param {string} method
 * @param {string} path below the API's base, as "/plan"
 * @param {unknown} [document] the body of the request
 * @param {{signal?: AbortSignal}} [options]
 * @returns {Promise<any>} the document that answers
 * @throws {ApiError}
 */
export async function ask(method, path, document, options = {}) {
  /** @type {RequestInit} */
  const init = { method, signal: options.signal };
  if (document !== undefined) {
    init.body = JSON.stringify(document);
    init.headers = { "Content-Type": "application/json" };
  }
  const response = await request(path, init);
  try {
    return await response.json();
  } catch (error) {
    if (options.signal?.aborted) throw error;
    throw new ApiError("Unreachable", "the manager's answer was cut off", 0);
  }
}

/**
 * Fetches a document, and has the browser save it.
 *
 * @param {string} path below the API's base
 * @param {string} filename
 * @throws {ApiError}
 */
export async function download(path, filename) {
  save(await (await request(path)).blob(), filename);
}

/**
 * @param {Blob} blob
 * @param {string} filename
 */
export function save(blob, filename) {
  const address = URL.createObjectURL(blob);
  const link = document.createElement("a");
  link.href = address;
  link.download = filename;
  link.click();
  setTimeout(() => URL.revokeObjectURL(address), 10_000);
}

/**
 * @param {Response} response
 * @returns {Promise<ApiError>}
 */
async function refusal(response) {
  try {
    const { error } = await response.json();
    if (typeof error.kind === "string") return new ApiError(error.kind, String(error.message), response.status);
  } catch {
    // not the API's: a proxy's page, say
  }
  return new ApiError("Unexpected", `the manager answered ${response.status} ${response.statusText}`, response.status);
}
