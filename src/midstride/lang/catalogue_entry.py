"""The parts of an entry in the catalogue of diagnostics, and the texts that several examples start from."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from midstride.model.diagnostics import Severity
from midstride.model.printable import printable


@dataclass(frozen=True, slots=True)
class CatalogueExample:
    """An input that triggers a diagnostic. ``files`` are further files in its folder; bytes are written as they are."""

    text: str | bytes
    name: str = "example.stride"
    files: Mapping[str, str | bytes] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class CatalogueEntry:
    """The documentation of one diagnostic code: its title, its reason and inputs that trigger it."""

    code: str
    title: str
    explanation: str
    examples: tuple[CatalogueExample, ...]

    @property
    def severity(self) -> Severity:
        return "warning" if self.code.startswith("W") else "error"

    @property
    def shown_example(self) -> str | None:
        """The text of the first example, printable, unless it is binary or long."""
        text = self.examples[0].text
        return printable(text.rstrip()) if isinstance(text, str) and len(text) < 2000 else None

    def render(self) -> str:
        """The entry as `midstride explain` shows it."""
        paragraphs = [f"{self.severity} {self.code}: {self.title}"]
        paragraphs += [textwrap.fill(" ".join(part.split()), 100) for part in self.explanation.split("\n\n")]
        if (text := self.shown_example) is not None:
            paragraphs.append(f"For example ({self.examples[0].name}):\n\n" + textwrap.indent(text, "    "))
        return "\n\n".join(paragraphs)


def entry(heading: str, explanation: str, *examples: str | bytes | CatalogueExample) -> CatalogueEntry:
    """An entry with the heading ``E012: title``."""
    code, _, title = heading.partition(": ")
    inputs = (each if isinstance(each, CatalogueExample) else CatalogueExample(each) for each in examples)
    return CatalogueEntry(code, title, explanation, tuple(inputs))


TALKER: Final = """component Talker {
  output out
  functionality talk {
    produces out
    mode normal { guarantee out : std_msgs/msg/String @ 10 Hz }
    mode silent { }
  }
}
"""
CHATTER: Final = "system s\ntopic /chatter : std_msgs/msg/String @ 10 Hz\n" + TALKER
NODE: Final = "node talker : Talker { out -> /chatter }\n"
TALKING: Final = CHATTER + NODE
STARTED: Final = CHATTER.replace("  output", '  run "python3 -m s.talker"\n  output')


def respawning(policy: str) -> str:
    """A system whose talker has this restart policy."""
    return STARTED + f"node talker : Talker {{ out -> /chatter   {policy} }}\n"
