"""The entry point: loads a system from a file, in the Stride language or in JSON."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from midstride.errors import SpecificationError
from midstride.lang.checker import Resolved, check_files
from midstride.lang.diagnostic_text import Diagnostic, has_errors, in_order
from midstride.lang.json_form import check_json, places_of
from midstride.lang.message_types import MessageTypes
from midstride.lang.program_checks import missing_programs
from midstride.lang.source import Source
from midstride.lang.source_files import FileReader, Unreadable, read_source, read_text
from midstride.lang.source_map import SourceMap
from midstride.model.specification import Specification


@dataclass(frozen=True, slots=True)
class Loaded:
    """The result of loading a file. ``specification`` is None iff there are errors; ``files`` are all files read.

    ``resolved`` holds the declarations behind it, with or without errors; None for JSON and for an unreadable file.
    """

    specification: Specification | None
    diagnostics: tuple[Diagnostic, ...]
    files: tuple[Source, ...] = ()
    resolved: Resolved | None = None

    @property
    def has_errors(self) -> bool:
        return has_errors(self.diagnostics)

    def require(self) -> Specification:
        """The specification. Raises SpecificationError with the diagnostics if there are errors."""
        if self.specification is None:
            raise SpecificationError([d for d in self.diagnostics if d.severity == "error"])
        return self.specification


def load(path: Path | str, *, read: FileReader = read_text, messages: MessageTypes | None = None) -> Loaded:
    """Load the system that a file declares: JSON if its name ends in ``.json``, else the Stride language.

    ``read`` returns the text of each file. Types and fields are looked up in ``messages``; None: they are not checked.
    Programs that are not there are warned of.
    """
    path = Path(path)
    try:
        source = read_source(path, read)
    except Unreadable as error:
        diagnostic = Diagnostic(error.code, f"`{path}` cannot be read: {error}", help=error.help, file=str(path))
        return Loaded(None, (diagnostic,))
    loaded = _load_source(source, read, messages)
    return replace(loaded, diagnostics=in_order([*loaded.diagnostics, *_missing_programs(loaded, path)]))


def _missing_programs(loaded: Loaded, path: Path) -> list[Diagnostic]:
    problems = [] if loaded.specification is None else list(missing_programs(loaded.specification, path.parent))
    if not problems:
        return []
    if loaded.resolved is None:
        places = places_of(loaded.files[0])
        spans = [places.get(problem.subject) for problem in problems]
    else:
        source_map = SourceMap(loaded.resolved.declarations, loaded.resolved.components.merged, {})
        spans = [source_map.span_of(problem) for problem in problems]
    return [
        Diagnostic(problem.code, problem.message, span, problem.help, file=str(path))
        for problem, span in zip(problems, spans, strict=True)
    ]


def load_text(
    text: str,
    name: str = "<text>",
    *,
    read: FileReader = read_text,
    messages: MessageTypes | None = None,
) -> Loaded:
    """Load the system that a text declares. Includes are relative to ``name``, that of its file."""
    return _load_source(Source(name, text, Path(name)), read, messages)


def _load_source(source: Source, read: FileReader, messages: MessageTypes | None) -> Loaded:
    if source.name.endswith(".json"):
        specification, diagnostics = check_json(source)
        return Loaded(specification, diagnostics, (source,))
    found, diagnostics, files, resolved = check_files(source, read, messages)
    return Loaded(found, diagnostics, files, resolved)
