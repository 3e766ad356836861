"""From tokens to the syntax of a file: a recursive-descent parser with error recovery.

Every independent error is reported once, at its place; a statement that cannot be parsed is skipped. Parsing always
terminates, with bounded recursion, and does not raise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from midstride.lang.blocks import Handlers
from midstride.lang.diagnostics import Note, Reporter
from midstride.lang.lexer import tokenize
from midstride.lang.parse_component import ComponentParser
from midstride.lang.source import Source
from midstride.lang.syntax import (
    Attachment,
    ContractDeclaration,
    EnvironmentBlock,
    EnvironmentOffer,
    File,
    FunctionalityName,
    IncludeStatement,
    Item,
    KeepStatement,
    LimitStatement,
    Name,
    NamespaceBlock,
    NodeDeclaration,
    Number,
    OrderStatement,
    ParameterEntry,
    ParameterFile,
    ResourceDeclaration,
    StepDuration,
    TimingBlock,
    TopicDeclaration,
)
from midstride.lang.token_stream import Panic

MAX_NESTING: Final = 16


def parse(source: Source, reporter: Reporter) -> File:
    """The syntax of ``source``, without the parts that cannot be parsed."""
    return Parser(tokenize(source, reporter), reporter).file()


class Parser(ComponentParser):
    """The parser for files; its base classes parse contracts and components."""

    _system: Name | None = None
    _depth = 0

    def file(self) -> File:
        items: list[Item] = []
        self._open.append((0, {}))
        handlers: dict[str, Callable[[], None]] = {"system": self._read_system, **self._handlers(items)}
        self.statements("this file", None, handlers)
        return File(self.tokens, self.layout, self._system, tuple(items), frozenset(self.skipped))

    def _read_system(self) -> None:
        self.i += 1
        name = self.name("a system name")
        if self._system is not None:
            note = Note("first named here", self._system.span)
            self.reporter.report("E128", name.span, "a file can name only one system", notes=[note])
            return
        self._system = name

    def _handlers(self, items: list[Item]) -> Handlers:
        readers: Mapping[str, Callable[[], Item]] = {
            "include": self._include,
            "contract": self._contract,
            "topic": self._topic,
            "resource": self._resource,
            "environment": self._environment,
            "component": self.component,
            "node": self._node,
            "namespace": self._namespace,
            "parameters": self._parameter_file,
            "keep": self._keep,
            "limit": self._limit,
            "order": self._order,
            "timing": self._timing,
        }
        return {word: lambda read=read: items.append(read()) for word, read in readers.items()}  # type: ignore[misc]

    def _include(self) -> IncludeStatement:
        start = self.i
        self.i += 1
        if self.kinds[self.i] != "string":
            help = f'write `include "{self.texts[self.i]}.stride"`' if self.kinds[self.i] in {"name", "path"} else None
            raise self.fail("a file name in double quotes after `include`", help)
        path = self.text("a file name")
        return IncludeStatement(self.since(start), path)

    def _contract(self) -> ContractDeclaration:
        start = self.i
        self.i += 1
        name = self.name("a contract name", ("=",))
        self.layout.marks[self.i] = "contract ="
        try:
            if self.kinds[self.i] == ":":
                message = "a contract is defined with `=`, not `:`"
                self.reporter.report("E120", self.span(), message, help=f"write `contract {name.text} = …`")
                self.i += 1
            else:
                self.expect("=", f"after contract `{name.text}`", ("path",))
            return ContractDeclaration(self.since(start), name, self.contract(f"for `{name.text}`"))
        except Panic:
            self._skip_statement(start)
            return ContractDeclaration(self.since(start), name, None)

    def _topic(self) -> TopicDeclaration:
        start = self.i
        self.i += 1
        name = self.topic("a topic name")
        limits: list[Number] = []
        self.layout.marks[self.i] = "topic :"
        try:
            self.expect(":", f"after topic `{name.text}`", ("path", "name"))
            contract = self.contract(f"for topic `{name.text}`")
            if self.kinds[self.i] == "{":
                self.block(f"topic `{name.text}`", start, {}, lambda: self._publishers(limits))
        except Panic:
            self._skip_statement(start)
            return TopicDeclaration(self.since(start), name, None, None)
        return TopicDeclaration(self.since(start), name, contract, limits[0] if limits else None)

    def _publishers(self, limits: list[Number]) -> bool:
        if not self.at_word("publishers"):
            raise self.fail("`publishers <= N`")
        if limits:
            self.reporter.report("E128", self.span(), "duplicate limit on publishers", help="keep one of them")
        self.i += 1
        self.expect("<=", "after `publishers`", ("number",))
        number = self.number("a number of publishers")
        if number.value != int(number.value):
            self.reporter.report("E126", number.span, "the number of publishers must be a whole number")
            number = Number(float(int(number.value)), number.span)
        limits.append(number)
        return True

    def _resource(self) -> ResourceDeclaration:
        start = self.i
        self.i += 1
        name = self.resource("a resource name or device path")
        capacity: Number | None = None
        self.layout.marks[self.i] = "resource ="
        if self.accept("="):
            capacity = self.number("a capacity")
        return ResourceDeclaration(self.since(start), name, capacity)

    def _environment(self) -> EnvironmentBlock:
        first = self.i
        self.i += 1
        offers: list[EnvironmentOffer] = []

        def offer() -> None:
            start = self.i
            self.i += 1
            name = self.name("the name of a guarantee", (":",))
            topic = self.topic("a topic name after `on`") if self.accept_word("on") else None
            self.expect(":", f"after `{name.text}`", ("path",))
            offers.append(EnvironmentOffer(self.since(start), name, topic, self.contract(f"for `{name.text}`")))

        self.block("the environment", first, {"guarantee": offer})
        return EnvironmentBlock(self.since(first), tuple(offers))

    # -- nodes -----------------------------------------------------------------------------------------

    def _node(self) -> NodeDeclaration:
        first = self.i
        self.i += 1
        name = self.name("a node name", (":",))
        component: Name | None = None
        attachments: list[Attachment] = []
        parameters: list[ParameterEntry] = []
        files: list[Name] = []
        skipped: frozenset[str] = frozenset()

        def read_parameters() -> None:
            nonlocal skipped
            skipped |= self.parameters(parameters, files)

        self.layout.marks[self.i] = "node :"
        try:
            self.expect(":", f"after node `{name.text}`", ("name",))
            component = self.name("a component name", ("{",))
            if self.kinds[self.i] == "{":
                self.layout.marks[self.i] = "node {"
                skipped |= self.block(
                    f"node `{name.text}`", first, {"parameters": read_parameters}, lambda: self._attachment(attachments)
                )
        except Panic:
            self._skip_statement(first)
            skipped |= {"node"}
        incomplete = bool(skipped)
        return NodeDeclaration(
            self.since(first), name, component, tuple(attachments), tuple(parameters), tuple(files), incomplete
        )

    def _attachment(self, attachments: list[Attachment]) -> bool:
        if self.kinds[self.i] != "name" or self.kinds[self.i + 1] not in {"<-", "->", "=", ":", "path", "<"}:
            return False
        port = Name(self.texts[self.i], self.span())
        self.i += 1
        arrow = self.kinds[self.i]
        if arrow not in {"<-", "->"}:
            raise self.fail(f"`<-` (an input) or `->` (an output) after `{port.text}`")
        self.i += 1
        topics = [self.topic(f"a topic after `{arrow}`")]
        while (
            self.kinds[self.i] == ","
            and self.kinds[self.i + 1] in {"name", "path"}
            and self.kinds[self.i + 2] not in {"<-", "->"}
        ):
            if self.at_parameters(self.i + 1):
                break
            self.i += 1
            self.layout.items.add(self.i)
            topics.append(self.topic(f"a topic after `{arrow}`"))
        attachments.append(Attachment(port, arrow == "->", tuple(topics)))
        return True

    def at_parameters(self, index: int) -> bool:
        return self.texts[index] == "parameters" and self.kinds[index + 1] in {"{", "string"}

    def _namespace(self) -> NamespaceBlock:
        first = self.i
        self.i += 1
        name = self.topic("a namespace name")
        items: list[Item] = []
        if self._depth >= MAX_NESTING:
            message = f"namespaces are nested more than {MAX_NESTING} deep"
            self.reporter.report("E129", name.span, message, help="combine the inner names: `namespace a/b`")
            raise Panic
        self._depth += 1
        try:
            self.block(f"namespace `{name.text}`", first, self._handlers(items))
        finally:
            self._depth -= 1
        return NamespaceBlock(self.since(first), name, tuple(items))

    def _parameter_file(self) -> ParameterFile:
        start = self.i
        self.i += 1
        path = self.text(
            "a ROS parameter file name in double quotes (parameter values belong in a component or a node)"
        )
        return ParameterFile(self.since(start), path)

    # -- constraints and timing ------------------------------------------------------------------------

    def _functionality_name(self) -> FunctionalityName:
        role = self.topic("a node and its functionality, `node.functionality`")
        self.expect(".", f"after `{role.text}`, as in `node.functionality`", ())
        return FunctionalityName(role, self.name("a functionality name"))

    def _keep(self) -> KeepStatement:
        start = self.i
        self.i += 1
        self.layout.marks[self.i] = "constraint"
        functionality = self._functionality_name()
        self.expect_word("at", "and a mode after the functionality")
        return KeepStatement(self.since(start), functionality, self.name("a mode name"))

    def _limit(self) -> LimitStatement:
        start = self.i
        self.i += 1
        self.layout.marks[self.i] = "constraint"
        functionality = self._functionality_name()
        self.expect_word("below", "`baseline` and a time after the functionality")
        self.expect_word("baseline", "after `below`")
        return LimitStatement(self.since(start), functionality, self.seconds("a time"))

    def _order(self) -> OrderStatement:
        start = self.i
        self.i += 1
        self.layout.marks[self.i] = "constraint"
        before = self.topic("a node name after `order`")
        self.expect_word("before", "and another node")
        return OrderStatement(self.since(start), before, self.topic("a node name after `before`"))

    def _timing(self) -> TimingBlock:
        first = self.i
        self.i += 1
        durations: list[StepDuration] = []

        def duration() -> bool:
            if self.kinds[self.i] != "name" or self.kinds[self.i + 1] not in {"number", "=", ":"}:
                return False
            kind = Name(self.texts[self.i], self.span())
            self.i += 1
            if self.kinds[self.i] != "number":
                raise self.fail(f"a time after `{kind.text}`", f"write `{kind.text} 0.5 s`")
            durations.append(StepDuration(kind, self.seconds("a time")))
            return True

        self.block("the timing", first, {}, duration)
        return TimingBlock(self.since(first), tuple(durations))
