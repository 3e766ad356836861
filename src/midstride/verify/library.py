"""The Alloy specification as text: modules, their commands with what is expected, what a dump takes along."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Final, Literal

# The paper's listings as printed do not parse (docs/paper.md): they are kept, and no check runs on them.
PRINTED: Final = "printed"
# In the order in which one reads them.
MODULES: Final = (
    "completed", "core", "system", "actions", "groups", "handover", "limits", "best", "telling",
)  # fmt: skip
# What a dump carries along.
_CARRIED: Final = ("system", "actions", "groups", "handover", "limits", "telling")
_CHECKS: Final = re.compile(r"^/\* ---- checks\b", re.MULTILINE)
_COMMAND: Final = re.compile(
    r"^(?P<kind>check|run) (?P<name>\w+)\b(?P<rest>.*?)\bexpect (?P<expect>[01])$", re.MULTILINE | re.DOTALL
)
_SIGNATURE: Final = re.compile(
    r"^(?P<head>(?:abstract )?sig \w+(?: extends \w+|(?P<part> in \w+))?) \{[^}]*\}", re.MULTILINE
)
_DECLARED: Final = re.compile(r"^(?:abstract )?(?:sig|pred|fun) (\w+)", re.MULTILINE)
_FIELD: Final = re.compile(r"(\w+)\s*:")
_SCOPE: Final = re.compile(r"\bfor (\d+)((?: but)? [\w ,]+?)? expect [01]$")
_BIG: Final = 5


@dataclass(frozen=True, slots=True)
class AlloyCommand:
    """A ``check`` (expected to have no counterexample, mostly) or a ``run`` of a module."""

    module: str
    name: str
    kind: Literal["check", "run"]
    expected: bool
    scope: int

    def __str__(self) -> str:
        return f"{self.module}.{self.name}"


def source(module: str) -> str:
    """The text of a module of the specification."""
    return (files("midstride.verify") / "alloy" / f"{module}.als").read_text(encoding="utf-8")


def scoped(module: str, scope: int) -> str:
    """The text of a module, its checks to ``scope`` where they are stated to scope 5. The rest stays."""
    return source(module).replace(f"for {_BIG} but", f"for {min(scope, _BIG)} but")


def commands(module: str, scope: int = _BIG) -> list[AlloyCommand]:
    """The commands of a module, in their order, each with whether an instance is expected."""
    found = []
    for match in _COMMAND.finditer(scoped(module, scope)):
        kind: Literal["check", "run"] = "check" if match["kind"] == "check" else "run"
        stated = _SCOPE.search(match[0])
        assert stated is not None, f"{module}.{match['name']} states no scope"
        found.append(AlloyCommand(module, match["name"], kind, match["expect"] == "1", int(stated[1])))
    return found


def carried() -> str:
    """The specification for a dump to carry along: one text, without its modules' headings and checks.

    Its signatures are without their fields: a dump gives these as constants of the same names.
    """
    parts = []
    for module in _CARRIED:
        text = source(module)
        if found := _CHECKS.search(text):
            text = text[: found.start()]
        lines = [line for line in text.splitlines() if not line.startswith(("module ", "open "))]
        parts.append("\n".join(lines).strip() + "\n")
    return _SIGNATURE.sub(lambda match: "" if match["part"] else f"{match['head']} {{}}", "\n".join(parts))


@cache
def declared() -> frozenset[str]:
    """The names of all that a dump carries along: signatures, fields, predicates and functions."""
    text = "\n".join(source(module) for module in _CARRIED)
    fields = " ".join(match[0].partition("{")[2] for match in _SIGNATURE.finditer(text))
    return frozenset(_DECLARED.findall(text)) | frozenset(_FIELD.findall(fields))
