// Starts the language server, `midstride lsp`, for .stride files. All knowledge of the language is in the server.
const { workspace } = require("vscode");
const { LanguageClient } = require("vscode-languageclient/node");

let client;

async function activate() {
  const [command, ...args] = workspace.getConfiguration("midstride").get("command", ["midstride", "lsp"]);
  client = new LanguageClient(
    "midstride",
    "Midstride",
    { command, args },
    { documentSelector: [{ scheme: "file", language: "stride" }] }
  );
  await client.start();
}

async function deactivate() {
  if (client) await client.stop();
}

module.exports = { activate, deactivate };
