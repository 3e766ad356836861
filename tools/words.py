"""Checks words: ``python -m tools.words`` names each docstring and phrase that docs/style.md advises against.

Docstrings of `src`: none opens with a word that leans on the name above it. `src`, `docs`, `examples`, `ansible`,
`benchmarks` and the pages beside them: none of the phrases in PHRASES, each of which has what to write instead.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parent.parent
LEANING: Final = re.compile(r"(?:What|Whether|How|Why|Where|When|Which|Who|Those|That|These|It|Its|As|The same)\b")
DOCUMENTED: Final = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
# These pages name the phrases, and entries of the past keep their words.
EXCEPT: Final = {"docs/style.md", "CHANGELOG.md"}

_THING: Final = (
    r"(?:nodes?|components?|others|robot|systems?|manager|instances?|process(?:es)?|code|rest|servers?|it|they|one)"
)
PHRASES: Final = {
    rf"\b{_THING} (?:go|goes|went) on\b": "continue, or keep running",
    r"\b(?:is|are) to go\b": "is being replaced, or is being removed",
    r"\bwhat their programs are now\b": "with the code now on disk",
    r"\bnot let in\b": "rejected",
    r"\bmust be as it should\b": "name the state, such as: converged to its specification",
    r"\bmiddleware (?:stands|stood|may stand) still\b": "has stopped discovering",
    r"\btold to end\b": "is shutting down",
    r"\bbegins? nothing\b": "is shutting down",
    r"\bleaves? without it\b": "exits without waiting for it",
    r"\bobserved again, it may\b": "observe it and retry",
    r"\b(?:comes?|came) to it\b": "handles it",
    r"\bhas more rows\b": "row numbers are 32-bit",
    r"\bis stated, not guessed\b": "say what happens by default",
    r"\bfell by its reflex\b": "degraded by its reflex",
    r"\bnot how it ends\b": "interrupted by Ctrl-C",
    r"\bnothing to complain of\b": "no problems found",
    r"\bnobody can be asked\b": "not a terminal",
    r"\bwhat is wanted is there\b": "already matches the target",
}


def leaning(source: str) -> Iterator[str]:
    """The line and the opening of each docstring that begins with such a word."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, DOCUMENTED):
            words = ast.get_docstring(node)
            if words and LEANING.match(words):
                yield f"{node.body[0].lineno}: {words.splitlines()[0]}"


def phrases(text: str) -> Iterator[str]:
    """The line of each phrase in a text, and what to write instead."""
    # A phrase may begin on one line of a comment or paragraph, and end on the next one.
    lines = text.splitlines(keepends=True)
    joined = "".join(re.sub(r"^\s*(?:#|//|\*|>)?\s*", "", line).rstrip() + " " for line in lines)
    starts, start = [], 0
    for line in lines:
        starts.append(start)
        start += len(re.sub(r"^\s*(?:#|//|\*|>)?\s*", "", line).rstrip()) + 1
    for pattern, better in PHRASES.items():
        for found in re.finditer(pattern, joined, re.IGNORECASE):
            number = sum(begin <= found.start() for begin in starts)
            yield f"{number}: “{found[0]}”: {better}"


def files() -> Iterator[Path]:
    """The files whose phrases are checked."""
    yield from sorted(ROOT.glob("*.md"))
    for folder, suffixes in (
        ("src", {".py", ".c", ".h", ".js", ".html"}),
        ("docs", {".md"}),
        ("examples", {".md", ".py", ".stride"}),
        ("ansible", {".md", ".py", ".yml"}),
        ("benchmarks", {".py"}),
    ):
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix in suffixes and "vendor" not in path.parts:
                yield path


def faults() -> list[str]:
    """Everything that is found in the repository, each with its place."""
    found = []
    for path in files():
        name = path.relative_to(ROOT).as_posix()
        text = path.read_text(encoding="utf-8")
        if name not in EXCEPT:
            found += [f"{name}:{each}" for each in phrases(text)]
        if path.suffix == ".py" and name.startswith("src/"):
            found += [f"{name}:{each}" for each in leaning(text)]
    return found


if __name__ == "__main__":
    found = faults()
    print("\n".join(found) or "words: nothing found", file=sys.stderr if found else sys.stdout)
    sys.exit(1 if found else 0)
