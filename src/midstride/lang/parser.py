"""From tokens to the syntax of a file: recursive descent that goes on after errors.

Every independent error is reported once, where it stands; a statement that cannot be read is left
out, and no text makes this raise, loop or recurse without bound.
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
    Duration,
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
    TimingBlock,
    TopicDeclaration,
)
from midstride.lang.token_stream import Panic

MAX_NESTING: Final = 16


def parse(source: Source, reporter: Reporter) -> File:
    """The syntax of ``source``, as far as it can be read."""
    return Parser(tokenize(source, reporter), reporter).file()


class Parser(ComponentParser):
    """The whole parser; see its bases for contracts and components."""

    _system: Name | None = None
    _depth = 0

    def file(self) -> File:
        items: list[Item] = []
        self._open.append((0, {}))
        handlers: dict[str, Callable[[], None]] = {"system": self._read_system, **self._handlers(items)}
        self.statements("a file", None, handlers)
        return File(self.tokens, self.layout, self._system, tuple(items), frozenset(self.lost))

    def _read_system(self) -> None:
        self.i += 1
        name = self.name("the name of the system")
        if self._system is not None:
            note = Note("the first one is here", self._system.span)
            self.reporter.report("E128", name.span, "a file names its system once", notes=[note])
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
            raise self.fail("the name of a file in double quotes after `include`", help)
        path = self.text("the name of a file")
        return IncludeStatement(self.since(start), path)

    def _contract(self) -> ContractDeclaration:
        start = self.i
        self.i += 1
        name = self.name("the name of a contract", ("=",))
        self.layout.marks[self.i] = "contract ="
        try:
            if self.kinds[self.i] == ":":
                message = "a contract is given with `=`"
                self.reporter.report("E120", self.span(), message, help=f"write `contract {name.text} = …`")
                self.i += 1
            else:
                self.expect("=", f"after contract `{name.text}`", ("path",))
            return ContractDeclaration(self.since(start), name, self.contract(f"for `{name.text}`"))
        except Panic:
            self._skip(start)
            return ContractDeclaration(self.since(start), name, None)

    def _topic(self) -> TopicDeclaration:
        start = self.i
        self.i += 1
        name = self.topic("the name of a topic")
        cap: list[Number] = []
        self.layout.marks[self.i] = "topic :"
        try:
            self.expect(":", f"after topic `{name.text}`", ("path", "name"))
            contract = self.contract(f"for topic `{name.text}`")
            if self.kinds[self.i] == "{":
                self.block(f"topic `{name.text}`", start, {}, lambda: self._publishers(cap))
        except Panic:
            self._skip(start)
            return TopicDeclaration(self.since(start), name, None, None)
        return TopicDeclaration(self.since(start), name, contract, cap[0] if cap else None)

    def _publishers(self, cap: list[Number]) -> bool:
        if not self.at_word("publishers"):
            raise self.fail("`publishers <= N`")
        if cap:
            self.reporter.report("E128", self.span(), "the publishers are capped already", help="keep one of the two")
        self.i += 1
        self.expect("<=", "after `publishers`", ("number",))
        number = self.number("a number of publishers")
        if number.value != int(number.value):
            self.reporter.report("E126", number.span, "a number of publishers is whole: 0, 1, 2, …")
            number = Number(float(int(number.value)), number.span)
        cap.append(number)
        return True

    def _resource(self) -> ResourceDeclaration:
        start = self.i
        self.i += 1
        name = self.resource("the name of a resource, or the path of a device")
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
            topic = self.topic("the name of a topic after `on`") if self.accept_word("on") else None
            self.expect(":", f"after `{name.text}`", ("path",))
            offers.append(EnvironmentOffer(self.since(start), name, topic, self.contract(f"for `{name.text}`")))

        self.block("the environment", first, {"guarantee": offer})
        return EnvironmentBlock(self.since(first), tuple(offers))

    # -- nodes -----------------------------------------------------------------------------------------

    def _node(self) -> NodeDeclaration:
        first = self.i
        self.i += 1
        name = self.name("the name of a node", (":",))
        component: Name | None = None
        attachments: list[Attachment] = []
        parameters: list[ParameterEntry] = []
        files: list[Name] = []
        lost: frozenset[str] = frozenset()

        def read_parameters() -> None:
            nonlocal lost
            lost |= self.parameters(parameters, files)

        self.layout.marks[self.i] = "node :"
        try:
            self.expect(":", f"after node `{name.text}`", ("name",))
            component = self.name("the name of a component", ("{",))
            if self.kinds[self.i] == "{":
                self.layout.marks[self.i] = "node {"
                lost |= self.block(
                    f"node `{name.text}`", first, {"parameters": read_parameters}, lambda: self._attachment(attachments)
                )
        except Panic:
            self._skip(first)
            lost |= {"node"}
        broken = bool(lost)
        return NodeDeclaration(
            self.since(first), name, component, tuple(attachments), tuple(parameters), tuple(files), broken
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
        name = self.topic("the name of a namespace")
        items: list[Item] = []
        if self._depth >= MAX_NESTING:
            message = f"namespaces are nested more than {MAX_NESTING} deep here"
            self.reporter.report("E129", name.span, message, help="write the inner names as one: `namespace a/b`")
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
            "the name of a ROS parameter file in double quotes (values of their own belong in a component or a node)"
        )
        return ParameterFile(self.since(start), path)

    # -- constraints and timing ------------------------------------------------------------------------

    def _functionality_name(self) -> FunctionalityName:
        role = self.topic("a node and its functionality, `node.functionality`")
        self.expect(".", f"after `{role.text}`, and the name of one of its functionalities", ())
        return FunctionalityName(role, self.name("the name of a functionality"))

    def _keep(self) -> KeepStatement:
        start = self.i
        self.i += 1
        self.layout.marks[self.i] = "constraint"
        functionality = self._functionality_name()
        self.expect_word("at", "and a mode after the functionality")
        return KeepStatement(self.since(start), functionality, self.name("the name of a mode"))

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
        before = self.topic("the name of a node after `order`")
        self.expect_word("before", "and another node")
        return OrderStatement(self.since(start), before, self.topic("the name of a node after `before`"))

    def _timing(self) -> TimingBlock:
        first = self.i
        self.i += 1
        durations: list[Duration] = []

        def duration() -> bool:
            if self.kinds[self.i] != "name" or self.kinds[self.i + 1] not in {"number", "=", ":"}:
                return False
            kind = Name(self.texts[self.i], self.span())
            self.i += 1
            if self.kinds[self.i] != "number":
                raise self.fail(f"a time after `{kind.text}`", f"write `{kind.text} 0.5 s`")
            durations.append(Duration(kind, self.seconds("a time")))
            return True

        self.block("the timing", first, {}, duration)
        return TimingBlock(self.since(first), tuple(durations))
