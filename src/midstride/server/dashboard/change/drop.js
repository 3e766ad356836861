/**
 * A specification from a file that is dropped on the page, or chosen.
 *
 * @module
 */

/** As much as the manager reads of a request (bytes). */
const LARGEST = 1_000_000;

/**
 * @param {HTMLInputElement} input for those who do not drag
 * @param {(file: string, text: string | null) => void} onFile with null for a file that is larger
 */
export function listenForFiles(input, onFile) {
  const read = async (/** @type {File | undefined} */ file) => {
    if (file === undefined) return;
    onFile(file.name, file.size > LARGEST ? null : await file.text());
  };
  const carriesFile = (/** @type {DragEvent} */ event) => event.dataTransfer?.types.includes("Files") ?? false;
  input.addEventListener("change", async () => {
    await read(input.files?.[0]);
    input.value = ""; // so that the same file can be chosen again after it was edited
  });
  document.addEventListener("dragover", (event) => {
    if (!carriesFile(event)) return;
    event.preventDefault();
    document.body.classList.add("dropping");
  });
  document.addEventListener("dragleave", (event) => {
    if (event.relatedTarget === null) document.body.classList.remove("dropping");
  });
  document.addEventListener("drop", (event) => {
    document.body.classList.remove("dropping");
    if (!carriesFile(event)) return;
    event.preventDefault();
    read(event.dataTransfer?.files[0]);
  });
}
