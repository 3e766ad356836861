"""The Stride language: from text to a specification or diagnostics, and back to canonical text.

    loaded = load(Path("patrol.stride"))
    if loaded.specification is None:
        print(render(loaded.diagnostics))

Nothing here raises on account of what a file holds.
"""

from __future__ import annotations

from midstride.lang.diagnostics import Diagnostic, has_errors, render
from midstride.lang.load import Loaded, load, load_text
from midstride.lang.printer import Formatted, format_text

__all__ = ["Diagnostic", "Formatted", "Loaded", "format_text", "has_errors", "load", "load_text", "render"]
