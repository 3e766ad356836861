"""From tokens to the syntax of a file: a recursive-descent parser with error recovery.

Every independent error is reported once, at its place; a statement that cannot be parsed is skipped. Parsing always
terminates, with bounded recursion, and does not raise.
"""

from __future__ import annotations

from functools import partial
from typing import Final

from midstride.lang import syntax
from midstride.lang.blocks import Handlers
from midstride.lang.diagnostic_text import Note, Reporter
from midstride.lang.lexer import tokenize
from midstride.lang.parse_component import ComponentParser
from midstride.lang.source import Source
from midstride.lang.token_stream import RESPAWN_WORDS, Panic
from midstride.model.contract import ConnectorKind
from midstride.model.wording import KIND_WORDS, indefinite

MAX_NESTING: Final = 16

# What is stated of a host, each with the words for its value.
_HOST_DETAILS: Final = {"ssh": "a destination of `ssh`", "setup": "an absolute path", "folder": "an absolute path"}


def parse(source: Source, reporter: Reporter) -> syntax.File:
    """The syntax of ``source``, without the parts that cannot be parsed."""
    return Parser(tokenize(source, reporter), reporter).file()


class Parser(ComponentParser):
    """The parser for files; its base classes parse contracts and components."""

    _system: syntax.Name | None = None
    _depth = 0

    def file(self) -> syntax.File:
        items: list[syntax.Item] = []
        self._open.append((0, {}))
        self.statements("this file", None, {"system": self._read_system, **self._handlers(items)})
        return syntax.File(self.tokens, self.layout, self._system, tuple(items), frozenset(self.skipped))

    def _read_system(self, _: int) -> None:
        name = self.name("a system name")
        if self._system is not None:
            note = Note("first named here", self._system.span)
            self.reporter.report("E128", name.span, "a file can name only one system", notes=[note])
            return
        self._system = name

    def _handlers(self, items: list[syntax.Item]) -> Handlers:
        return {
            "include": lambda _: items.append(self._include()),
            "contract": lambda start: items.append(self._contract(start)),
            "topic": lambda start: items.append(self._topic(start, "topic")),
            "service": lambda start: items.append(self._topic(start, "service")),
            "action": lambda start: items.append(self._topic(start, "action")),
            "resource": lambda _: items.append(self._resource()),
            "host": lambda start: items.append(self._host_declaration(start)),
            "container": lambda start: items.append(self._container_declaration(start)),
            "environment": lambda start: self._environment(start, items),
            "component": lambda start: items.append(self.component(start)),
            "node": lambda start: items.append(self._node(start)),
            "namespace": lambda start: items.append(self._namespace(start)),
            "parameters": lambda _: items.append(self._parameter_file()),
            "keep": lambda start: items.append(self._keep(start)),
            "limit": lambda start: items.append(self._limit(start)),
            "order": lambda start: items.append(self._order(start)),
            "timing": lambda start: self._timing(start, items),
            "changes": lambda start: items.append(self._changes(start)),
        }

    def _include(self) -> syntax.IncludeStatement:
        if self.kinds[self.i] != "string":
            help = f'write `include "{self.texts[self.i]}.stride"`' if self.kinds[self.i] in {"name", "path"} else None
            raise self.fail("a file name in double quotes after `include`", help)
        return syntax.IncludeStatement(self.text("a file name"), self._on())

    def _on(self) -> syntax.Name | None:
        """The host after `on`, if it is stated."""
        return self.name("the name of a host after `on`", ("{",)) if self.accept_word("on") else None

    def _host_declaration(self, first: int) -> syntax.HostDeclaration:
        name = self.name("the name of a host", ("{",))
        found: dict[str, syntax.Name] = {}

        def detail(word: str, start: int) -> None:
            value = self.text(f"{_HOST_DETAILS[word]} in double quotes after `{word}`")
            if word in found:
                message = f"duplicate `{word}` of host `{name.text}`"
                self.reporter.report("E128", self.span(start), message, help="keep one of them")
            found.setdefault(word, value)

        self.block(f"host `{name.text}`", first, {word: partial(detail, word) for word in _HOST_DETAILS})
        return syntax.HostDeclaration(name, **found)

    def _contract(self, start: int) -> syntax.ContractDeclaration:
        name = self.name("a contract name", ("=",))
        self.layout.marks[self.i] = "contract ="
        try:
            if self.kinds[self.i] == ":":
                message = "a contract is defined with `=`, not `:`"
                self.reporter.report("E120", self.span(), message, help=f"write `contract {name.text} = …`")
                self.i += 1
            else:
                self.expect("=", f"after contract `{name.text}`", ("path",))
            return syntax.ContractDeclaration(name, self.contract(f"for `{name.text}`"))
        except Panic:
            self._skip_statement(start)
            return syntax.ContractDeclaration(name, None)

    def _topic(self, start: int, kind: ConnectorKind) -> syntax.TopicDeclaration:
        what = KIND_WORDS[kind].connector
        name = self.topic(f"{indefinite(what)} name")
        limits: list[syntax.Number] = []
        self.layout.marks[self.i] = "topic :"
        try:
            self.expect(":", f"after {what} `{name.text}`", ("path", "name"))
            contract = self.contract(f"for {what} `{name.text}`")
            if self.kinds[self.i] == "{" and kind == "topic":
                self.block(f"topic `{name.text}`", start, {}, lambda: self._publishers(limits))
        except Panic:
            self._skip_statement(start)
            return syntax.TopicDeclaration(name, None, None, kind)
        return syntax.TopicDeclaration(name, contract, limits[0] if limits else None, kind)

    def _publishers(self, limits: list[syntax.Number]) -> bool:
        if not self.at_word("publishers"):
            raise self.fail("`publishers <= N`")
        if limits:
            self.reporter.report("E128", self.span(), "duplicate limit on publishers", help="keep one of them")
        self.i += 1
        self.expect("<=", "after `publishers`", ("number",))
        limits.append(self._whole("a number of publishers"))
        return True

    def _whole(self, what: str) -> syntax.Number:
        number = self.number(what)
        if number.value == int(number.value):
            return number
        self.reporter.report("E126", number.span, f"{what.replace('a ', 'the ', 1)} must be a whole number")
        return syntax.Number(float(int(number.value)), number.span)

    def _resource(self) -> syntax.ResourceDeclaration:
        name = self.resource("a resource name or device path")
        host = self._on()
        self.layout.marks[self.i] = "resource ="
        capacity = self.number("a capacity") if self.accept("=") else None
        return syntax.ResourceDeclaration(name, capacity, host)

    def _container_declaration(self, first: int) -> syntax.ContainerDeclaration:
        name = self.topic("a container name")
        host = self._on()
        found: list[syntax.Run] = []
        environment: list[syntax.EnvironmentVariable] = []

        def run(start: int) -> None:
            if found:
                self.reporter.report(
                    "E128", self.span(start), "duplicate `run` of a container", help="keep one of them"
                )
            found.append(self.container_run(start))

        if self.kinds[self.i] == "{":
            handlers: Handlers = {"run": run, "environment": lambda start: self.variables(start, environment)}
            self.block(f"container `{name.text}`", first, handlers)
        return syntax.ContainerDeclaration(name, found[0] if found else None, tuple(environment), host)

    def _environment(self, first: int, items: list[syntax.Item]) -> None:
        def offer(_: int) -> None:
            name = self.name("the name of a guarantee", (":",))
            topic = self.topic("a topic name after `on`") if self.accept_word("on") else None
            self.expect(":", f"after `{name.text}`", ("path",))
            items.append(syntax.EnvironmentOffer(name, topic, self.contract(f"for `{name.text}`")))

        self.block("the environment", first, {"guarantee": offer})

    # -- nodes -----------------------------------------------------------------------------------------

    def _node(self, first: int) -> syntax.NodeDeclaration:
        name = self.name("a node name", (":",))
        component: syntax.Name | None = None
        container: syntax.Name | None = None
        host: syntax.Name | None = None
        attachments: list[syntax.Attachment] = []
        parameters: list[syntax.ParameterEntry] = []
        files: list[syntax.Name] = []
        respawn: list[syntax.RespawnStatement] = []
        handlers: Handlers = {
            "parameters": lambda start: self.parameters(start, parameters, files),
            **{word: partial(self._respawn, respawn, word) for word in RESPAWN_WORDS},
        }
        incomplete = False
        self.layout.marks[self.i] = "node :"
        try:
            self.expect(":", f"after node `{name.text}`", ("name",))
            component = self.name("a component name", ("{",))
            if self.accept_word("in"):
                container = self.topic("the name of a container after `in`")
            host = self._on()
            if self.kinds[self.i] == "{":
                self.layout.marks[self.i] = "node {"
                what = f"node `{name.text}`"
                incomplete = bool(self.block(what, first, handlers, lambda: self._attachment(attachments)))
        except Panic:
            self._skip_statement(first)
            incomplete = True
        stated = (tuple(attachments), tuple(parameters), tuple(files), tuple(respawn))
        return syntax.NodeDeclaration(name, component, *stated, incomplete, container, host)

    def _respawn(self, statements: list[syntax.RespawnStatement], word: str, start: int) -> None:
        amount, bound, component, unlimited, host = None, None, None, False, None
        if word == "respawn_delay":
            amount = self.seconds("a delay")
            bound = self.seconds("the longest delay") if self.accept_word("to") else None
        elif word == "respawn_max_retries":
            unlimited = self.accept_word("unlimited")
            amount = None if unlimited else self._whole("a number of restarts, or `unlimited`")
            bound = self.seconds("a time") if self.accept_word("in") else None
        elif word == "respawn_fallback":
            component = self.name("a component name")
            host = None if self._at_attachment() else self._on()
            if host is not None and not self._at_attachment() and self.accept_word("lease"):
                amount = self.seconds("the time of a lease")
        keyword = syntax.Name(word, self.span(start))
        stated = (amount, bound, component, unlimited, host)
        statements.append(syntax.RespawnStatement(keyword, self.since(start), *stated))

    def _at_attachment(self) -> bool:
        """Return whether the next word is the name of a port, whatever else it may mean."""
        return self.kinds[self.i + 1] in {"<-", "->"}

    def _attachment(self, attachments: list[syntax.Attachment]) -> bool:
        if self.kinds[self.i] != "name" or self.kinds[self.i + 1] not in {"<-", "->", "=", ":", "path", "<"}:
            return False
        port = self.take()
        if self.kinds[self.i] not in {"<-", "->"}:
            raise self.fail(f"`<-` (an input) or `->` (an output) after `{port.text}`")
        arrow = self.take().text
        topics = self.sequence(lambda: self.topic(f"a topic after `{arrow}`"), self._topic_at)
        attachments.append(syntax.Attachment(port, arrow == "->", topics))
        return True

    def _topic_at(self, at: int) -> bool:
        """Return whether another topic of an attachment is at the token ``at``: after a comma, and not the next
        statement.
        """
        if self.kinds[at - 1] != "," or self.kinds[at] not in {"name", "path"}:
            return False
        if self.texts[at] in RESPAWN_WORDS or (
            self.texts[at] == "parameters" and (self.kinds[at + 1] in {"{", "string"} or self.texts[at + 1] == "for")
        ):
            return False
        return self.kinds[at + 1] not in {"<-", "->"}

    def _namespace(self, first: int) -> syntax.NamespaceBlock:
        name = self.topic("a namespace name")
        host = self._on()
        items: list[syntax.Item] = []
        if self._depth >= MAX_NESTING:
            message = f"namespaces are nested more than {MAX_NESTING} deep"
            self.reporter.report("E129", name.span, message, help="combine the inner names: `namespace a/b`")
            raise Panic
        self._depth += 1
        try:
            self.block(f"namespace `{name.text}`", first, self._handlers(items))
        finally:
            self._depth -= 1
        return syntax.NamespaceBlock(name, tuple(items), host)

    def _parameter_file(self) -> syntax.ParameterFile:
        what = "a ROS parameter file name in double quotes (parameter values belong in a component or a node)"
        return syntax.ParameterFile(self.text(what))

    # -- constraints and timing ------------------------------------------------------------------------

    def _functionality_name(self) -> syntax.FunctionalityName:
        role = self.topic("a node and its functionality, `node.functionality`")
        self.expect(".", f"after `{role.text}`, as in `node.functionality`", ())
        return syntax.FunctionalityName(role, self.name("a functionality name"))

    def _keep(self, start: int) -> syntax.KeepStatement:
        self.layout.marks[self.i] = "constraint"
        functionality = self._functionality_name()
        self.expect_word("at", "and a mode after the functionality")
        return syntax.KeepStatement(self.since(start), functionality, self.name("a mode name"))

    def _limit(self, start: int) -> syntax.LimitStatement:
        self.layout.marks[self.i] = "constraint"
        functionality = self._functionality_name()
        self.expect_word("below", "`baseline` and a time after the functionality")
        self.expect_word("baseline", "after `below`")
        return syntax.LimitStatement(self.since(start), functionality, self.seconds("a time"))

    def _order(self, start: int) -> syntax.OrderStatement:
        self.layout.marks[self.i] = "constraint"
        before = self.topic("a node name after `order`")
        self.expect_word("before", "and another node")
        return syntax.OrderStatement(self.since(start), before, self.topic("a node name after `before`"))

    def _changes(self, start: int) -> syntax.ChangesStatement:
        recovery = self.accept_word("and")
        if recovery:
            self.expect_word("recovery", "after `changes and`")
        self.expect_word("require", f"after `changes{' and recovery' if recovery else ''}`")
        topic = self.topic("a topic name after `require`")
        if topic.text.startswith("~"):
            message = f"`{topic.text}` is private to a node, but this is not inside one"
            self.reporter.report("E139", topic.span, message, help="write the full name: `/node/topic`")
            topic = syntax.Name(topic.text[1:], topic.span)
        self.layout.marks[self.i] = "changes :"
        self.expect(":", f"after topic `{topic.text}`", ("path", "name"))
        contract = self.contract(f"for topic `{topic.text}`")
        max_age = self.seconds("the age of a message") if self.accept_word("max_age") else None
        return syntax.ChangesStatement(self.since(start), topic, contract, max_age, recovery)

    def _timing(self, first: int, items: list[syntax.Item]) -> None:
        def duration() -> bool:
            if self.kinds[self.i] != "name" or self.kinds[self.i + 1] not in {"number", "=", ":"}:
                return False
            kind = self.take()
            if self.kinds[self.i] != "number":
                raise self.fail(f"a time after `{kind.text}`", f"write `{kind.text} 0.5 s`")
            items.append(syntax.StepDuration(kind, self.seconds("a time")))
            return True

        self.block("the timing", first, {}, duration)
