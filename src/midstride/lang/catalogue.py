"""The catalogue of diagnostics: for each code its meaning, its reason and inputs that trigger it.

Codes below E100 and W100 apply to every form of a specification; those from 100 on concern the text form. A test checks
that each entry is reachable and that each diagnostic has an entry.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from midstride.lang.catalogue_entry import CatalogueEntry
from midstride.lang.catalogue_model import MODEL
from midstride.lang.catalogue_semantics import SEMANTICS
from midstride.lang.catalogue_syntax import SYNTAX
from midstride.model.near_miss import did_you_mean

CATALOGUE: Final[Mapping[str, CatalogueEntry]] = {
    entry.code: entry for entry in (*MODEL, *sorted((*SYNTAX, *SEMANTICS), key=lambda entry: entry.code))
}


def explain(code: str) -> str:
    """The documentation of a code. Raises KeyError, suggesting a similar code, if it does not exist."""
    entry = CATALOGUE.get(code.upper())
    if entry is None:
        raise KeyError(f"there is no diagnostic `{code}`; {did_you_mean(code, CATALOGUE) or 'codes look like E012'}")
    return entry.render()


def reference() -> str:
    """The whole catalogue as a documentation page in Markdown."""
    parts = [
        "# Diagnostics",
        "All diagnostics of `midstride check`, by code: `E` is an error, `W` a warning. `midstride explain CODE` "
        "shows the same text on the terminal. Codes below 100 concern the meaning of a specification in any form; "
        "codes from 100 on concern its text.",
    ]
    for entry in CATALOGUE.values():
        parts.append(f"## {entry.code}: {entry.title}")
        parts += [" ".join(part.split()) for part in entry.explanation.split("\n\n")]
        if (text := entry.shown_example) is not None:
            kind = "json-example" if entry.examples[0].name.endswith(".json") else "stride"
            parts.append(f"```{kind}\n{text or '# an empty file'}\n```")
    return "\n\n".join(parts) + "\n"
