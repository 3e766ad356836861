"""Completion: the keywords and names that can be written at a position."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final

from midstride.lang.checker import Resolved
from midstride.lang.contract_builder import POLICIES, POLICY_WORDS
from midstride.lang.diagnostic_text import Reporter
from midstride.lang.lexer import Tokens, tokenize
from midstride.lang.source import Source
from midstride.lang.syntax import ComponentDeclaration, find
from midstride.lang.token_stream import KEYWORD_PLACES, RESERVED, RESPAWN_WORDS
from midstride.model.component import GATES
from midstride.model.hosts import MANAGER
from midstride.model.specification import TIMING

# What comes before a keyword that is used as a name.
_BEFORE_NAMES: Final = frozenset({".", "<-", "->", ":"})
_TOP_LEVEL: Final = tuple(word for word, where in KEYWORD_PLACES.items() if where.startswith("at"))
# The statements in each kind of block, by its keyword; "": at the top level.
_STATEMENTS: Final = {
    "": (*_TOP_LEVEL, "parameters"),
    "namespace": (*_TOP_LEVEL, "parameters"),
    "component": (
        *(word for word, where in KEYWORD_PLACES.items() if where.startswith("in a component")),
        *("action server", "action client", "parameters", "environment"),
    ),
    "functionality": ("uses", "produces", "mode"),
    "mode": ("assume", "guarantee", "parameters"),
    "node": ("parameters", *RESPAWN_WORDS),
    "environment": ("guarantee",),
    "timing": TIMING,
    "topic": ("publishers",),
    "container": ("run", "environment"),
    "host": ("ssh", "setup", "folder"),
    "parameters": ("changeable",),
}


# What may follow the command of a component.
_RUN_CLAUSES: Final = ("package", "in", "takes", "activate", "stop", "gate")


@dataclass(frozen=True, slots=True)
class Completion:
    """A proposed word and its kind: ``keyword``, ``contract``, ``topic``, ``component``, ``node``, ``port``, …"""

    word: str
    kind: str


def complete(source: Source, offset: int, resolved: Resolved) -> list[Completion]:
    """The words that can be written at ``offset``. They are not filtered by a partial word there: the editor does."""
    text = source.text[:offset]
    while text and (text[-1].isalnum() or text[-1] in "_/~"):
        text = text[:-1]
    tokens = tokenize(Source("", text), Reporter())
    if _in_comment_or_text(tokens, text):
        return []
    offered = _CursorContext(tokens, resolved).candidates()
    return list(dict.fromkeys(Completion(word, kind) for kind, words in offered for word in words))


def _in_comment_or_text(tokens: Tokens, text: str) -> bool:
    if tokens.comments and tokens.comments[-1][1] == len(text) and not text.endswith("\n"):
        return True
    last = tokens.texts[-2] if len(tokens.texts) > 1 else ""
    return last.startswith('"') and (len(last) == 1 or not last.endswith('"'))


class _CursorContext:
    """The context after the last token: the open blocks, and the current statement."""

    def __init__(self, tokens: Tokens, resolved: Resolved) -> None:
        self.kinds = tokens.kinds[:-1]
        self.texts = tokens.texts[:-1]
        self.resolved = resolved
        self.blocks = self._open_blocks()  # the index of the keyword of each open block
        self.statement = self._statement()

    def _open_blocks(self) -> list[int]:
        open_: list[int] = []
        head = -1
        for index, (kind, text) in enumerate(zip(self.kinds, self.texts, strict=True)):
            if kind == "name" and text in _STATEMENTS and (not index or self.kinds[index - 1] not in _BEFORE_NAMES):
                head = index
            elif kind == "{":
                open_.append(head if self.texts[index - 1] != "in" else -1)
            elif kind == "}" and open_:
                open_.pop()
        return open_

    def _statement(self) -> list[str]:
        """The tokens since the last statement keyword or brace."""
        found: list[str] = []
        for kind, text in zip(reversed(self.kinds), reversed(self.texts), strict=True):
            if kind in {"{", "}"} and not (found and kind == "{" and "in" in self.texts[-len(found) - 2 :]):
                break
            found.append(text)
            if kind == "name" and text in RESERVED:
                break
        return found[::-1]

    def candidates(self) -> Iterator[tuple[str, Iterable[str]]]:
        """Words of a kind, with the kind first."""
        last = self.texts[-1] if self.texts else ""
        first = self.statement[0] if self.statement else ""
        declarations = self.resolved.declarations
        block = self.texts[self.blocks[-1]] if self.blocks and self.blocks[-1] >= 0 else ""
        component = self._component()
        inputs = [port.name.text for port in component.inputs] if component else []
        if last in {"<-", "->"} or (last == "on" and first == "guarantee"):
            yield "topic", declarations.topics
        elif last in {"like", "respawn_fallback"} or (last == ":" and first == "node"):
            yield "component", declarations.components
        elif last == "@":
            return
        elif "qos" in self.statement and self.statement.count("(") > self.statement.count(")"):
            name = self.statement[-2] if last == "=" else ""
            yield ("value", POLICY_WORDS.get(name, ())) if name else ("keyword", POLICIES)
        elif last == ":" or (last == "=" and first == "contract"):
            yield "contract", declarations.contracts
        elif first == "assume" and last in {"assume", "or"}:
            yield "port", inputs
            yield "contract", declarations.contracts if last == "assume" else ()
        elif first == "uses":
            yield "port", inputs
        elif first in {"produces", "guarantee"} and last in {"produces", "guarantee", ","} and component is not None:
            yield "port", [output.text for output in component.outputs]
        elif first in {"input", "client"} and last == "tolerates":
            return
        elif first in {"input", "client"} and self.statement[-2:-1] == ["tolerates"]:
            yield "keyword", ("missed",)
        elif first == "run" and last == "gate":
            yield "keyword", GATES
        elif first == "run" and last == "stop":
            yield "keyword", ("drain", "patience", "sigterm", "sigkill")
        elif first in {"node", "container", "namespace", "resource", "include", "respawn_fallback"} and last == "on":
            yield "host", (*declarations.hosts, MANAGER)
        elif first == "node" and last == "in":
            yield "container", declarations.containers
        elif last == "holds":
            yield "resource", dict.fromkeys(declared.name.text for declared in declarations.resources.values())
        elif self.statement in (["keep"], ["limit"]) or (first == "order" and last in {"order", "before"}):
            yield "node", declarations.nodes
        elif first in {"keep", "limit"} and last == ".":
            found = self._node_component(self.statement[1])
            yield "functionality", [f.name.text for f in found.functionalities] if found else ()
        elif first == "keep" and last == "at" and len(self.statement) > 3:
            found = self._node_component(self.statement[1])
            functionality = find(found.functionalities, self.statement[3]) if found else None
            yield "mode", [mode.name.text for mode in functionality.modes] if functionality else ()
        else:
            if first == "input" and ":" in self.statement and "condition" not in self.statement:
                yield "keyword", ("condition",) if "tolerates" in self.statement else ("condition", "tolerates")
            if first == "client" and ":" in self.statement and "tolerates" not in self.statement:
                yield "keyword", ("tolerates",)
            if first == "run" and last not in {"run", "stop"}:
                yield "keyword", _RUN_CLAUSES
            if first == "output" and len(self.statement) > 1 and last != "lazy":
                yield "keyword", ("lazy",)
            if first == "respawn_fallback":
                yield "keyword", ("lease",) if "on" in self.statement else ("on",)
            yield "keyword", _STATEMENTS.get(block, ())
            if block == "node":
                found = self._declared(self._word_after(self.blocks[-1], 3))
                yield "port", [port.name.text for port in found.inputs] if found else ()
                yield "port", [output.text for output in found.outputs] if found else ()

    def _word_after(self, index: int, places: int) -> str:
        at = index + places
        return self.texts[at] if index >= 0 and at < len(self.texts) else ""

    def _component(self) -> ComponentDeclaration | None:
        """The component whose block encloses the cursor."""
        for index in reversed(self.blocks):
            if index >= 0 and self.texts[index] == "component":
                return self._declared(self._word_after(index, 1))
        return None

    def _declared(self, name: str) -> ComponentDeclaration | None:
        return self.resolved.components.merged.get(name)

    def _node_component(self, role: str) -> ComponentDeclaration | None:
        entry = self.resolved.declarations.nodes.get(role)
        component = None if entry is None else entry.declaration.component
        return None if component is None else self._declared(component.text)
