"""The Stride language: parsing, checking and formatting.

    loaded = load(Path("patrol.stride"))
    if loaded.specification is None:
        print(render(loaded.diagnostics))

Errors in a file are returned as diagnostics; no file content makes these functions raise.
"""

from __future__ import annotations

from midstride.lang.diagnostic_text import Diagnostic, has_errors, render
from midstride.lang.load import Loaded, load, load_text
from midstride.lang.printer import Formatted, format_text

PUBLIC = (
    "Bounds CATALOGUE ComponentDeclaration Diagnostic File INCLUDE_PATH InvalidYaml Item LanguageService MAX_TOTAL "
    "NamespaceBlock NodeDeclaration OrderStatement ParameterValueAt RESERVED Reporter SectionInFile Source "
    "Span TopicDeclaration Unreadable explain format_text include_folders installed load load_text parse read_sections "
    "read_source read_text resolve_name sections_of"
)

__all__ = ["Diagnostic", "Formatted", "Loaded", "format_text", "has_errors", "load", "load_text", "render"]
