"""The catalogue of diagnostics, as data: for each code what it means, why it is one, and inputs that trigger it.

Codes below E100 and W100 are the model's (:mod:`midstride.model.diagnostics`): they hold however a specification is
written. Those from 100 on are the text's. A test holds that each entry is reachable and that each diagnostic has an
entry.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from midstride.lang.catalogue_model import MODEL
from midstride.lang.catalogue_text import TEXT
from midstride.lang.diagnostics import Severity
from midstride.model.diagnostics import CATALOGUE as MODEL_KINDS
from midstride.model.near_miss import did_you_mean


@dataclass(frozen=True, slots=True)
class CatalogueExample:
    """An input that triggers a diagnostic. ``files`` lie beside it; what is in bytes is no text."""

    text: str | bytes
    name: str = "example.stride"
    files: Mapping[str, str | bytes] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Entry:
    """One kind of diagnostic."""

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


def _entries() -> dict[str, Entry]:
    entries: dict[str, Entry] = {}
    for code, (explanation, examples) in MODEL.items():
        kind = MODEL_KINDS[code]
        told = f"{explanation}\n\nWhat to do: {kind.advice}."
        entries[code] = Entry(code, kind.title, told, tuple(CatalogueExample(*example) for example in examples))
    for code, (title, explanation, examples) in TEXT.items():
        entries[code] = Entry(code, title, explanation, tuple(CatalogueExample(*example) for example in examples))
    return entries


CATALOGUE: Final[Mapping[str, Entry]] = _entries()


def explain(code: str) -> str:
    """What a code means. Raises KeyError, with a near miss in its message, for one that does not exist."""
    entry = CATALOGUE.get(code.upper())
    if entry is None:
        raise KeyError(
            f"there is no diagnostic `{code}`; {did_you_mean(code, CATALOGUE) or 'codes are written as E012'}"
        )
    return entry.render()


def reference() -> str:
    """The whole catalogue as a page of the documentation (Markdown)."""
    parts = [
        "# Diagnostics",
        "Every diagnostic of `midstride check`, by code: `E` is an error, `W` a warning. `midstride explain CODE` "
        "shows the same on the terminal. Codes below 100 are about what a specification says, however it is written "
        "down; those from 100 on about its text.",
    ]
    for entry in CATALOGUE.values():
        parts.append(f"## {entry.code}: {entry.title}")
        parts += [" ".join(part.split()) for part in entry.explanation.split("\n\n")]
        example = entry.examples[0]
        if isinstance(example.text, str) and len(example.text) < 2000:
            kind = "json-example" if example.name.endswith(".json") else "stride"
            parts.append(f"```{kind}\n{example.text.rstrip() or '# an empty file'}\n```")
    return "\n\n".join(parts) + "\n"
