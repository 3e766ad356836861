"""The language server: :mod:`midstride.lang.service` over the Language Server Protocol, with pygls."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlparse

from lsprotocol import types
from pygls.exceptions import JsonRpcInvalidParams
from pygls.lsp.server import LanguageServer

from midstride import __version__
from midstride.lang.diagnostic_text import Diagnostic
from midstride.lang.message_types import installed
from midstride.lang.service import LanguageService
from midstride.lang.source import Source, Span

_KINDS = {
    "keyword": types.CompletionItemKind.Keyword,
    "contract": types.CompletionItemKind.Interface,
    "topic": types.CompletionItemKind.Event,
    "component": types.CompletionItemKind.Class,
    "node": types.CompletionItemKind.Variable,
    "port": types.CompletionItemKind.Field,
    "functionality": types.CompletionItemKind.Method,
    "mode": types.CompletionItemKind.EnumMember,
    "resource": types.CompletionItemKind.Constant,
    "value": types.CompletionItemKind.Value,
}


def make_server() -> LanguageServer:
    """A server, not yet started; ``start_io`` runs it on standard input and output."""
    server = LanguageServer("midstride", __version__)
    service = LanguageService(messages=cache(installed))
    shown: dict[Path, set[Path]] = {}  # file -> the files for which its diagnostics were last published

    def publish(path: Path) -> None:
        found = service.diagnostics(path)
        for other in shown.get(path, set()) - set(found):
            found[other] = []
        shown[path] = {other for other, listed in found.items() if listed}
        for other, listed in found.items():
            parameters = types.PublishDiagnosticsParams(_uri(other), [_diagnostic(d) for d in listed])
            server.text_document_publish_diagnostics(parameters)

    def place(parameters: Any) -> tuple[Path, int, int]:
        path, line = _path(parameters.text_document.uri), parameters.position.line + 1
        source = service.analysis(path).source(path)
        text = source.line(line) if source is not None and line <= len(source.starts) else ""
        return path, line, _column(text, parameters.position.character) + 1

    @server.feature(types.INITIALIZED)
    def initialized(parameters: types.InitializedParams) -> None:
        service.roots = [_path(folder.uri) for folder in server.workspace.folders.values()]

    @server.feature(types.TEXT_DOCUMENT_DID_OPEN)
    @server.feature(types.TEXT_DOCUMENT_DID_CHANGE)
    def did_change(parameters: types.DidOpenTextDocumentParams | types.DidChangeTextDocumentParams) -> None:
        uri = parameters.text_document.uri
        service.open(_path(uri), server.workspace.get_text_document(uri).source)
        publish(_path(uri))

    @server.feature(types.TEXT_DOCUMENT_DID_CLOSE)
    def did_close(parameters: types.DidCloseTextDocumentParams) -> None:
        path = _path(parameters.text_document.uri)
        service.close(path)
        for other in shown.pop(path, set()):
            server.text_document_publish_diagnostics(types.PublishDiagnosticsParams(_uri(other), []))

    @server.feature(types.TEXT_DOCUMENT_HOVER)
    def hover(parameters: types.HoverParams) -> types.Hover | None:
        text = service.hover(*place(parameters))
        return None if text is None else types.Hover(types.MarkupContent(types.MarkupKind.Markdown, text))

    @server.feature(types.TEXT_DOCUMENT_DEFINITION)
    def definition(parameters: types.DefinitionParams) -> types.Location | None:
        span = service.definition(*place(parameters))
        return None if span is None else _location(span)

    @server.feature(types.TEXT_DOCUMENT_REFERENCES)
    def references(parameters: types.ReferenceParams) -> list[types.Location]:
        return [_location(span) for span in service.references(*place(parameters))]

    @server.feature(types.TEXT_DOCUMENT_RENAME)
    def rename(parameters: types.RenameParams) -> types.WorkspaceEdit:
        try:
            edits = service.rename(*place(parameters), parameters.new_name)
        except ValueError as error:
            raise JsonRpcInvalidParams(str(error)) from None
        changes: dict[str, list[types.TextEdit]] = {}
        for span, text in edits:
            at = _location(span)
            changes.setdefault(at.uri, []).append(types.TextEdit(at.range, text))
        return types.WorkspaceEdit(changes=changes)

    options = types.CompletionOptions(trigger_characters=[":", "<", ">", "-", ".", "/", " "])

    @server.feature(types.TEXT_DOCUMENT_COMPLETION, options)
    def completion(parameters: types.CompletionParams) -> types.CompletionList:
        offered = service.complete(*place(parameters))
        items = [types.CompletionItem(c.word, kind=_KINDS.get(c.kind), detail=c.kind) for c in offered]
        return types.CompletionList(is_incomplete=False, items=items)

    @server.feature(types.TEXT_DOCUMENT_FORMATTING)
    def formatting(parameters: types.DocumentFormattingParams) -> list[types.TextEdit] | None:
        path = _path(parameters.text_document.uri)
        text = service.format(path)
        old = service.buffers.get(str(path), "")
        if text is None or text == old:
            return None
        whole = types.Range(types.Position(0, 0), types.Position(old.count("\n") + 1, 0))
        return [types.TextEdit(whole, text)]

    return server


def _path(uri: str) -> Path:
    return Path(unquote(urlparse(uri).path))


def _uri(path: Path) -> str:
    return path.absolute().as_uri()


def _units(text: str) -> int:
    """The length of ``text`` in UTF-16 code units, which the protocol counts in."""
    return len(text.encode("utf-16-le", "surrogatepass")) // 2


def _column(line: str, units: int) -> int:
    """The number of characters of ``line`` before a column given in UTF-16 code units."""
    encoded = line.encode("utf-16-le", "surrogatepass")[: 2 * units]
    return len(encoded.decode("utf-16-le", "ignore"))


def _position(source: Source, offset: int) -> types.Position:
    line, column = source.position(offset)
    return types.Position(line - 1, _units(source.line(line)[: column - 1]))


def _range(span: Span) -> types.Range:
    return types.Range(_position(span.source, span.start), _position(span.source, span.end))


def _location(span: Span) -> types.Location:
    return types.Location(_uri(span.source.path or Path(span.source.name)), _range(span))


def _diagnostic(diagnostic: Diagnostic) -> types.Diagnostic:
    start = types.Position(0, 0)
    parts = [diagnostic.message, f"so: {diagnostic.follows}" if diagnostic.follows else "", diagnostic.help or ""]
    return types.Diagnostic(
        range=_range(diagnostic.span) if diagnostic.span is not None else types.Range(start, start),
        message="\n".join(part for part in parts if part),
        severity=types.DiagnosticSeverity.Error if diagnostic.severity == "error" else types.DiagnosticSeverity.Warning,
        code=diagnostic.code,
        source="midstride",
        related_information=[
            types.DiagnosticRelatedInformation(_location(note.span), note.message) for note in diagnostic.notes
        ],
    )
