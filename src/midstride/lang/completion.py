"""What may be written at a place of a file: the words and names that an editor offers."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from midstride.lang.check import Resolved
from midstride.lang.contracts import POLICIES, policy_words
from midstride.lang.diagnostics import Reporter
from midstride.lang.lexer import Tokens, tokenize
from midstride.lang.source import Source
from midstride.lang.syntax import ComponentDeclaration
from midstride.lang.token_stream import BELONGS
from midstride.model.specification import DEFAULT_SECONDS

_HEADS: Final = (
    "component",
    "functionality",
    "mode",
    "node",
    "namespace",
    "environment",
    "timing",
    "topic",
    "parameters",
)
_OUTER: Final = tuple(word for word, where in BELONGS.items() if where.startswith("at"))
_STATEMENTS: Final = {
    "": (*_OUTER, "parameters"),
    "namespace": (*_OUTER, "parameters"),
    "component": ("run", "holds", "input", "output", "allows", "functionality", "parameters"),
    "functionality": ("uses", "produces", "mode"),
    "mode": ("assume", "guarantee"),
    "node": ("parameters",),
    "environment": ("guarantee",),
    "timing": tuple(DEFAULT_SECONDS),
    "topic": ("publishers",),
    "parameters": ("changeable",),
}


@dataclass(frozen=True, slots=True)
class Completion:
    """A word to offer, and what it is: ``keyword``, ``contract``, ``topic``, ``component``, ``node``, ``port``, …"""

    word: str
    kind: str


def complete(source: Source, offset: int, resolved: Resolved) -> list[Completion]:
    """What may stand at ``offset``. The word that is begun there plays no part: the editor filters."""
    text = source.text[:offset]
    while text and (text[-1].isalnum() or text[-1] in "_/~"):
        text = text[:-1]
    tokens = tokenize(Source("", text), Reporter())
    if _in_comment_or_text(tokens, text):
        return []
    return list(dict.fromkeys(_Place(tokens, resolved).offers()))


def _in_comment_or_text(tokens: Tokens, text: str) -> bool:
    if tokens.comments and tokens.comments[-1][1] == len(text) and not text.endswith("\n"):
        return True
    last = tokens.texts[-2] if len(tokens.texts) > 1 else ""
    return last.startswith('"') and (len(last) == 1 or not last.endswith('"'))


class _Place:
    """The place behind the last token: which blocks are open there, and which words came before."""

    def __init__(self, tokens: Tokens, resolved: Resolved) -> None:
        self.kinds = tokens.kinds[:-1]
        self.texts = tokens.texts[:-1]
        self.resolved = resolved
        self.blocks = self._open_blocks()  # the index of each open block's head
        self.statement = self._statement()

    def _open_blocks(self) -> list[int]:
        open_: list[int] = []
        head = -1
        for index, (kind, text) in enumerate(zip(self.kinds, self.texts, strict=True)):
            if kind == "name" and text in _HEADS and not (index and self.kinds[index - 1] in {".", "<-", "->", ":"}):
                head = index
            elif kind == "{":
                open_.append(head if self.texts[index - 1] != "in" else -1)
            elif kind == "}" and open_:
                open_.pop()
        return open_

    def _statement(self) -> list[str]:
        """The words since the last one that begins a statement, or since the last brace."""
        found: list[str] = []
        for kind, text in zip(reversed(self.kinds), reversed(self.texts), strict=True):
            if kind in {"{", "}"} and not (found and kind == "{" and "in" in self.texts[-len(found) - 2 :]):
                break
            found.append(text)
            if kind == "name" and text in BELONGS:
                break
        return found[::-1]

    def offers(self) -> Iterable[Completion]:
        last = self.texts[-1] if self.texts else ""
        first = self.statement[0] if self.statement else ""
        declarations = self.resolved.declarations
        block = self.texts[self.blocks[-1]] if self.blocks and self.blocks[-1] >= 0 else ""
        component = self._component()
        if last in {"<-", "->"} or (last == "on" and first == "guarantee"):
            yield from _all("topic", declarations.topics)
        elif last == "like" or (last == ":" and first == "node"):
            yield from _all("component", declarations.components)
        elif last in {"@"}:
            return
        elif "qos" in self.statement and self.statement.count("(") > self.statement.count(")"):
            name = self.statement[-2] if last == "=" else ""
            yield from _all("value", policy_words(name)) if name else _all("keyword", POLICIES)
        elif last == ":" or (last == "=" and first == "contract"):
            yield from _all("contract", declarations.contracts)
        elif first == "assume" and last in {"assume", "or"}:
            yield from _all("port", [port.name.text for port in component.inputs] if component else ())
            yield from _all("contract", declarations.contracts if last == "assume" else ())
        elif first == "uses":
            yield from _all("port", [port.name.text for port in component.inputs] if component else ())
        elif first in {"produces", "guarantee"} and last in {"produces", "guarantee", ","} and component is not None:
            yield from _all("port", [output.text for output in component.outputs])
        elif last == "holds":
            yield from _all("resource", declarations.resources)
        elif (first in {"keep", "limit"} and len(self.statement) == 1) or (
            first == "order" and last in {"order", "before"}
        ):
            yield from _all("node", declarations.nodes)
        elif first in {"keep", "limit"} and last == ".":
            found = self._node_component(self.statement[1])
            yield from _all("functionality", [f.name.text for f in found.functionalities] if found else ())
        elif first == "keep" and last == "at" and len(self.statement) > 3:
            found = self._node_component(self.statement[1])
            chains = [f.modes for f in found.functionalities if f.name.text == self.statement[3]] if found else []
            yield from _all("mode", [mode.name.text for modes in chains for mode in modes])
        else:
            yield from _all("keyword", _STATEMENTS.get(block, ()))
            if block == "node":
                found = self._declared(self._word_after(self.blocks[-1], 3))
                yield from _all("port", _ports(found) if found else ())

    def _word_after(self, index: int, places: int) -> str:
        at = index + places
        return self.texts[at] if index >= 0 and at < len(self.texts) else ""

    def _component(self) -> ComponentDeclaration | None:
        """The component whose block is open."""
        for index in reversed(self.blocks):
            if index >= 0 and self.texts[index] == "component":
                return self._declared(self._word_after(index, 1))
        return None

    def _declared(self, name: str) -> ComponentDeclaration | None:
        return self.resolved.components.merged.get(name)

    def _node_component(self, role: str) -> ComponentDeclaration | None:
        entry = self.resolved.declarations.nodes.get(role)
        return (
            None
            if entry is None or entry.declaration.component is None
            else self._declared(entry.declaration.component.text)
        )


def _ports(component: ComponentDeclaration) -> list[str]:
    return [*(port.name.text for port in component.inputs), *(output.text for output in component.outputs)]


def _all(kind: str, words: Iterable[str]) -> Iterable[Completion]:
    return (Completion(word, kind) for word in words)
