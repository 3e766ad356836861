"""The catalogue of diagnostics, as data: for each code its meaning, its reason and inputs that trigger it.

Codes below E100 and W100 come from the model (:mod:`midstride.model.diagnostics`) and apply to every form of a
specification. Those from 100 on concern the text form. A test checks that each entry is reachable and that each
diagnostic has an entry.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from midstride.lang.catalogue_model import MODEL
from midstride.lang.catalogue_semantics import SEMANTICS
from midstride.lang.catalogue_syntax import SYNTAX, ExampleParts
from midstride.lang.diagnostics import Severity
from midstride.model.diagnostics import CATALOGUE as MODEL_KINDS
from midstride.model.near_miss import did_you_mean


@dataclass(frozen=True, slots=True)
class CatalogueExample:
    """An input that triggers a diagnostic. ``files`` are further files in its folder; bytes are written as they are."""

    text: str | bytes
    name: str = "example.stride"
    files: Mapping[str, str | bytes] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class CatalogueEntry:
    """The documentation of one diagnostic code."""

    code: str
    title: str
    explanation: str
    examples: tuple[CatalogueExample, ...]

    @property
    def severity(self) -> Severity:
        return "warning" if self.code.startswith("W") else "error"

    def render(self) -> str:
        """The entry as `midstride explain` shows it."""
        paragraphs = [f"{self.severity} {self.code}: {self.title}"]
        paragraphs += [textwrap.fill(" ".join(part.split()), 100) for part in self.explanation.split("\n\n")]
        example = self.examples[0]
        if isinstance(example.text, str) and len(example.text) < 2000:
            paragraphs.append(f"For example ({example.name}):\n\n" + textwrap.indent(example.text.rstrip(), "    "))
        return "\n\n".join(paragraphs)


def _entry(code: str, title: str, explanation: str, examples: tuple[ExampleParts, ...]) -> CatalogueEntry:
    return CatalogueEntry(code, title, explanation, tuple(CatalogueExample(*parts) for parts in examples))


def _entries() -> dict[str, CatalogueEntry]:
    entries: dict[str, CatalogueEntry] = {}
    for code, (explanation, examples) in MODEL.items():
        kind = MODEL_KINDS[code]
        entries[code] = _entry(code, kind.title, f"{explanation}\n\nWhat to do: {kind.advice}.", examples)
    for code, (title, explanation, examples) in sorted({**SYNTAX, **SEMANTICS}.items()):
        entries[code] = _entry(code, title, explanation, examples)
    return entries


CATALOGUE: Final[Mapping[str, CatalogueEntry]] = _entries()


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
        example = entry.examples[0]
        if isinstance(example.text, str) and len(example.text) < 2000:
            kind = "json-example" if example.name.endswith(".json") else "stride"
            parts.append(f"```{kind}\n{example.text.rstrip() or '# an empty file'}\n```")
    return "\n\n".join(parts) + "\n"
