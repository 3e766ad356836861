"""The entry point: loads a system from a file, in the Stride language or in JSON."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from midstride.errors import SpecificationError
from midstride.lang.check import Resolved, check_files
from midstride.lang.diagnostics import Diagnostic, has_errors
from midstride.lang.files import FileReader, Unreadable, read_source, read_text
from midstride.lang.json_form import check_json
from midstride.lang.message_types import MessageTypes
from midstride.lang.source import Source
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
    """
    path = Path(path)
    try:
        source = read_source(path, read)
    except Unreadable as error:
        diagnostic = Diagnostic(error.code, f"`{path}` cannot be read: {error}", help=error.help, file=str(path))
        return Loaded(None, (diagnostic,))
    return _load_source(source, read, messages)


def load_text(
    text: str,
    name: str = "<text>",
    *,
    path: Path | None = None,
    read: FileReader = read_text,
    messages: MessageTypes | None = None,
) -> Loaded:
    """Load the system that a text declares. Includes are relative to ``path``, or to ``name`` if that is None."""
    return _load_source(Source(name, text, path or Path(name)), read, messages)


def _load_source(source: Source, read: FileReader, messages: MessageTypes | None) -> Loaded:
    if source.name.endswith(".json"):
        specification, diagnostics = check_json(source)
        return Loaded(specification, diagnostics, (source,))
    found, diagnostics, files, resolved = check_files(source, read, messages)
    return Loaded(found, diagnostics, files, resolved)
