"""The Alloy specification as text: its modules, their commands with the expected results, and the part for dumps."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Final, Literal

# In reading order.
MODULES: Final = (
    "completed", "core", "system", "actions", "groups", "handover", "limits", "best", "diagnosis",
)  # fmt: skip
# The modules that a dump includes.
_BUNDLED: Final = ("system", "actions", "groups", "handover", "limits", "diagnosis")
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
_FULL_SCOPE: Final = 5


@dataclass(frozen=True, slots=True)
class AlloyCommand:
    """A ``check`` or a ``run`` of a module; ``expected`` says whether it should have a counterexample or instance."""

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


def with_scope(module: str, scope: int) -> str:
    """The text of a module, with the checks of scope 5 limited to ``scope``."""
    return source(module).replace(f"for {_FULL_SCOPE} but", f"for {min(scope, _FULL_SCOPE)} but")


def commands(module: str, scope: int = _FULL_SCOPE) -> list[AlloyCommand]:
    """The commands of a module, in order."""
    found = []
    for match in _COMMAND.finditer(with_scope(module, scope)):
        kind: Literal["check", "run"] = "check" if match["kind"] == "check" else "run"
        stated = _SCOPE.search(match[0])
        assert stated is not None, f"{module}.{match['name']} states no scope"
        found.append(AlloyCommand(module, match["name"], kind, match["expect"] == "1", int(stated[1])))
    return found


def bundled() -> str:
    """The specification as one text for a dump, without the modules' headings and checks.

    Its signatures have no fields: a dump defines constants of the same names.
    """
    parts = []
    for module in _BUNDLED:
        text = source(module)
        if found := _CHECKS.search(text):
            text = text[: found.start()]
        lines = [line for line in text.splitlines() if not line.startswith(("module ", "open "))]
        parts.append("\n".join(lines).strip() + "\n")
    return _SIGNATURE.sub(lambda match: "" if match["part"] else f"{match['head']} {{}}", "\n".join(parts))


@cache
def declared_names() -> frozenset[str]:
    """The names that a dump includes: signatures, fields, predicates and functions."""
    text = "\n".join(source(module) for module in _BUNDLED)
    fields = " ".join(match[0].partition("{")[2] for match in _SIGNATURE.finditer(text))
    return frozenset(_DECLARED.findall(text)) | frozenset(_FIELD.findall(fields))
