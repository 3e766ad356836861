"""The language server in a session with a client, over standard input and output."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pygls", reason="the extra `lsp` is not installed")

from lsprotocol import types
from pygls.lsp.client import LanguageClient

from midstride.cli.language_server import _column, _units

PATROL = Path(__file__).parents[1] / "lang" / "seeds" / "patrol.stride"


def test_columns_are_counted_in_code_units() -> None:
    line = 'run "\U0001f916é" x'
    assert _units(line[:6]) == 7
    assert _column(line, 7) == 6
    assert _column(line, 100) == len(line)


async def session(folder: Path) -> dict[str, Any]:
    """Open, break, query, close: the answers of the server."""
    client = LanguageClient("test", "1")
    shown: dict[str, list[types.Diagnostic]] = {}
    arrived = asyncio.Event()

    @client.feature(types.TEXT_DOCUMENT_PUBLISH_DIAGNOSTICS)  # type: ignore[untyped-decorator, unused-ignore]
    def published(parameters: types.PublishDiagnosticsParams) -> None:
        shown[parameters.uri] = list(parameters.diagnostics)
        arrived.set()

    async def until(holds: Callable[[], bool]) -> None:
        while not holds():
            arrived.clear()
            await asyncio.wait_for(arrived.wait(), 30)

    await client.start_io(sys.executable, "-m", "midstride", "lsp", "--stdio")
    answers: dict[str, Any] = {}
    started = await client.initialize_async(
        types.InitializeParams(capabilities=types.ClientCapabilities(), root_uri=folder.as_uri())
    )
    answers["capabilities"] = started.capabilities
    client.initialized(types.InitializedParams())
    path = folder / "patrol.stride"
    uri, text = path.as_uri(), path.read_text(encoding="utf-8")
    item = types.TextDocumentItem(uri, "stride", 1, text)
    client.text_document_did_open(types.DidOpenTextDocumentParams(item))
    await until(lambda: len(shown) == 2)
    answers["clean"] = dict(shown)
    broken = text.replace("/obstacles   cmd", "/obstacle cmd")
    change = types.TextDocumentContentChangeWholeDocument(broken)
    version = types.VersionedTextDocumentIdentifier(2, uri)
    client.text_document_did_change(types.DidChangeTextDocumentParams(version, [change]))
    await until(lambda: bool(shown[uri]))
    answers["broken"] = shown[uri]
    document = types.TextDocumentIdentifier(uri)
    line = next(n for n, content in enumerate(text.split("\n")) if content.startswith("node controller"))
    spot = types.Position(line, text.split("\n")[line].index("MotorController") + 3)
    answers["hover"] = await client.text_document_hover_async(types.HoverParams(document, spot))
    answers["definition"] = await client.text_document_definition_async(types.DefinitionParams(document, spot))
    answers["rename"] = await client.text_document_rename_async(types.RenameParams(document, spot, "Motor"))
    answers["completion"] = await client.text_document_completion_async(types.CompletionParams(document, spot))
    options = types.FormattingOptions(2, True)
    answers["format"] = await client.text_document_formatting_async(types.DocumentFormattingParams(document, options))
    await client.shutdown_async(None)
    client.exit(None)
    await client.stop()  # type: ignore[no-untyped-call, unused-ignore]
    answers["uri"] = uri
    return answers


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_session(tmp_path: Path) -> None:
    for name in ("patrol.stride", "sensors.stride"):
        (tmp_path / name).write_text((PATROL.parent / name).read_text(encoding="utf-8"), encoding="utf-8")
    answers = asyncio.run(asyncio.wait_for(session(tmp_path), 60))
    capabilities = answers["capabilities"]
    assert capabilities.hover_provider
    assert capabilities.definition_provider
    assert capabilities.rename_provider
    assert capabilities.document_formatting_provider
    assert answers["clean"][answers["uri"]] == []
    (fault,) = [d for d in answers["broken"] if d.severity == types.DiagnosticSeverity.Error]
    assert (fault.code, fault.source) == ("E008", "midstride")
    assert "there is no topic `/obstacle`" in fault.message
    assert "did you mean `/obstacles`?" in fault.message
    assert "**component** `MotorController`" in answers["hover"].contents.value
    assert answers["definition"].uri == answers["uri"]
    assert len(answers["rename"].changes[answers["uri"]]) == 2
    assert {item.label for item in answers["completion"].items} >= {"MotorController", "Lidar"}
    (edit,) = answers["format"]
    assert "obstacles <- /obstacle   cmd -> /cmd_vel" in edit.new_text


def test_a_session_ends_in_order() -> None:
    """After `shutdown` and `exit` the status is 0, as the protocol says, and nothing is complained of."""

    def message(method: str, **rest: object) -> bytes:
        body = json.dumps({"jsonrpc": "2.0", "method": method, **rest}).encode()
        return b"Content-Length: %d\r\n\r\n" % len(body) + body

    messages = [
        message("initialize", id=1, params={"processId": None, "rootUri": None, "capabilities": {}}),
        message("initialized", params={}),
        message("shutdown", id=2),
        message("exit"),
    ]
    command = [sys.executable, "-m", "midstride", "lsp"]
    ended = subprocess.run(command, input=b"".join(messages), capture_output=True, timeout=60, check=False)
    assert b"Traceback" not in ended.stderr, ended.stderr.decode()
    assert ended.returncode == 0
