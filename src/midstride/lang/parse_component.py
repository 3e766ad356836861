"""Parsing of components: command, resources, ports, functionalities and modes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeVar

from midstride.lang import syntax
from midstride.lang.blocks import Handlers
from midstride.lang.parse_contract import ContractParser
from midstride.model.component import GATES
from midstride.model.contract import ConnectorKind
from midstride.model.near_miss import nearest
from midstride.model.wording import KIND_WORDS, indefinite

ENDPOINT_KINDS = ("topic", "service", "ROS action")
_MODE_WORDS: Final = ("assume", "guarantee", "parameters")

_Stated = TypeVar("_Stated", syntax.AssumptionExpression, syntax.GuaranteeStatement)


class ComponentParser(ContractParser):
    """The part of the parser for components."""

    def component(self, first: int) -> syntax.ComponentDeclaration:
        name = self.name("a component name", ("{",))
        like = self.name("a component name after `like`") if self.accept_word("like") else None
        runs: list[syntax.Run] = []
        holds: list[tuple[syntax.ResourceUse, ...]] = []
        parameters: list[syntax.ParameterEntry] = []
        files: list[syntax.Name] = []
        environment: list[syntax.EnvironmentVariable] = []
        inputs: list[syntax.InputDeclaration] = []
        outputs: list[syntax.Name] = []
        allows: list[syntax.AllowedEndpoint] = []
        functionalities: list[syntax.FunctionalityDeclaration] = []
        topics: list[syntax.OwnTopic] = []
        lazy: list[syntax.Name] = []
        served: list[syntax.ServerDeclaration] = []
        unread_parameters: set[str] = set()
        handlers: Handlers = {
            "run": lambda start: runs.append(self._run(start)),
            "holds": lambda _: holds.append(self._holds()),
            "parameters": lambda start: unread_parameters.update(self.parameters(start, parameters, files)),
            "environment": lambda start: unread_parameters.update(self.variables(start, environment)),
            "input": lambda _: inputs.append(self._input(topics)),
            "output": lambda _: outputs.append(self._output(topics, lazy)),
            "client": lambda _: inputs.append(self._client("service", topics)),
            "server": lambda _: outputs.append(self._server("service", topics, served)),
            "action": lambda _: self._action_port(inputs, outputs, topics, served),
            "allows": lambda _: allows.append(self._allows()),
            "functionality": lambda start: functionalities.append(self._functionality(start)),
        }
        skipped: frozenset[str] = frozenset()
        if like is None or self.kinds[self.i] == "{":
            skipped = self.block(f"component `{name.text}`", first, handlers)
        return syntax.ComponentDeclaration(
            name,
            like,
            tuple(runs),
            tuple(holds),
            tuple(parameters),
            tuple(files),
            tuple(environment),
            tuple(inputs),
            tuple(outputs),
            tuple(allows),
            tuple(functionalities),
            tuple(topics),
            tuple(lazy),
            tuple(served),
            skipped | {"parameters"} if unread_parameters else skipped,
        )

    def _run(self, start: int) -> syntax.Run:
        composable = self.accept_word("component")
        what = f"a {'class' if composable else 'command'} in double quotes after `run{' component' * composable}`"
        if self.kinds[self.i] in {"name", "path"}:
            words = self.rest_of_line()
            raise self.fail(what, f'write `run{" component" * composable} "{words}"`')
        command = self.text(what)
        package = self._package()
        container = self._container() if composable else None
        prefix = self._prefix()
        startup = self._startup()
        activate = self.seconds("a time to activate") if self.accept_word("activate") else None
        stop = self._stop() if self.accept_word("stop") else None
        word = self.span()
        once = word if self.accept_word("once") else None
        gate = self._gate() if self.accept_word("gate") else None
        unnamed = self.accept_word("unnamed")
        renames = self.name("what the program calls its node after `renames`") if self.accept_word("renames") else None
        span = self.since(start)
        return syntax.Run(
            command, package, container, prefix, startup, activate, stop, gate, once, unnamed, renames, span
        )

    def container_run(self, start: int) -> syntax.Run:
        """``run "component_container_mt" package "rclcpp_components"``, with the details of its process."""
        program = self.text("the program of a component container in double quotes after `run`")
        package, prefix, startup = self._package(), self._prefix(), self._startup()
        stop = self._stop() if self.accept_word("stop") else None
        return syntax.Run(
            command=program,
            package=package,
            container=None,
            prefix=prefix,
            startup=startup,
            activate=None,
            stop=stop,
            gate=None,
            once=None,
            unnamed=False,
            renames=None,
            span=self.since(start),
        )

    def _prefix(self) -> syntax.Name | None:
        return self.text("the words before the program in double quotes") if self.accept_word("prefix") else None

    def _startup(self) -> syntax.Number | None:
        return self.seconds("a startup time") if self.accept_word("takes") else None

    def _package(self) -> syntax.Name | None:
        return self.text("a package in double quotes after `package`") if self.accept_word("package") else None

    def _container(self) -> syntax.ContainerClause:
        """``in "component_container_mt" package "rclcpp_components"``, which may be left out."""
        if not self.accept_word("in"):
            return syntax.ContainerClause(None, None)
        program = self.text("the program of a component container in double quotes after `in`")
        return syntax.ContainerClause(program, self._package())

    def _stop(self) -> syntax.StopClause:
        start = self.i - 1
        drain = self.seconds("a time after `drain`") if self.accept_word("drain") else None
        patience = self.seconds("a time after `patience`") if self.accept_word("patience") else None
        sigterm = self.seconds("a time after `sigterm`") if self.accept_word("sigterm") else None
        sigkill = self.seconds("a time after `sigkill`") if self.accept_word("sigkill") else None
        if drain is None and patience is None and sigterm is None and sigkill is None:
            help = "write for example `stop sigterm 10 s sigkill 5 s`"
            raise self.fail("`drain`, `patience`, `sigterm` or `sigkill` after `stop`", help)
        return syntax.StopClause(drain, patience, sigterm, sigkill, self.since(start))

    def _gate(self) -> syntax.Name | None:
        gate, start = self.name("`preload`, `relay`, `lifecycle` or `none` after `gate`"), self.i - 1
        if gate.text == "lifecycle" and self.accept_word("preload"):
            return syntax.Name("lifecycle preload", self.since(start))
        if gate.text in GATES:
            return gate
        help = "use `preload`, `relay`, `lifecycle`, `lifecycle preload` or `none`"
        self.reporter.report("E120", gate.span, f"`{gate.text}` is not a kind of gate", help=help)
        return None

    def variables(self, first: int, variables: list[syntax.EnvironmentVariable]) -> frozenset[str]:
        """``environment { NAME = "value"  unset NAME }``."""

        def entry() -> bool:
            if self.kinds[self.i] != "name" or self.kinds[self.i + 1] not in {"=", "name"}:
                return False
            if self.kinds[self.i + 1] == "name":
                if not self.accept_word("unset"):
                    return False
                variables.append(syntax.EnvironmentVariable(self.name("a variable after `unset`"), None))
                return True
            name = self.name("a variable")
            self.expect("=", f"after `{name.text}`", ("string",))
            variables.append(syntax.EnvironmentVariable(name, self.text("a value in double quotes")))
            return True

        return self.block("the environment", first, {}, entry, ", ")

    def _holds(self) -> tuple[syntax.ResourceUse, ...]:
        if self.accept_word("nothing"):
            return ()

        def use() -> syntax.ResourceUse:
            resource = self.resource("a resource")
            return syntax.ResourceUse(resource, self.number("an amount") if self.kinds[self.i] == "number" else None)

        return self.sequence(use, lambda at: self.kinds[at] in {"name", "path", "string"} and not self.is_keyword(at))

    def resource(self, what: str) -> syntax.Name:
        """A resource name or a device path, in double quotes or without."""
        return self.text(what) if self.kinds[self.i] == "string" else self.topic(what)

    def _input(self, topics: list[syntax.OwnTopic]) -> syntax.InputDeclaration:
        self.layout.marks[self.i] = "port"
        name = self.name("an input name", (":",))
        self.layout.marks[self.i] = "input :"
        self.expect(":", f"after input `{name.text}`", ("name", "path"))
        contract = self.contract(f"for input `{name.text}`")
        tolerated = self._tolerated() if self.accept_word("tolerates") else None
        span = self.span()
        condition = span if self.accept_word("condition") else None
        self._own_topic(name, topics)
        return syntax.InputDeclaration(name, contract, tolerated, condition)

    def _client(self, kind: ConnectorKind, topics: list[syntax.OwnTopic]) -> syntax.InputDeclaration:
        words = KIND_WORDS[kind].input
        self.layout.marks[self.i] = "port"
        name = self.name(f"the name of {indefinite(words)}", (":",))
        self.layout.marks[self.i] = "input :"
        self.expect(":", f"after {words} `{name.text}`", ("name", "path"))
        contract = self.contract(f"for {words} `{name.text}`")
        tolerated = self._tolerated() if self.accept_word("tolerates") else None
        self._own_topic(name, topics)
        return syntax.InputDeclaration(name, contract, tolerated, None, kind)

    def _server(
        self, kind: ConnectorKind, topics: list[syntax.OwnTopic], served: list[syntax.ServerDeclaration]
    ) -> syntax.Name:
        self.layout.marks[self.i] = "port"
        name = self.name(f"the name of {indefinite(KIND_WORDS[kind].output)}", ("server", ":"))
        self._no_contract(name, KIND_WORDS[kind].output)
        self._own_topic(name, topics)
        served.append(syntax.ServerDeclaration(name, kind))
        return name

    def _action_port(
        self,
        inputs: list[syntax.InputDeclaration],
        outputs: list[syntax.Name],
        topics: list[syntax.OwnTopic],
        served: list[syntax.ServerDeclaration],
    ) -> None:
        """``action server NAME`` or ``action client NAME : CONTRACT``."""
        if self.accept_word("client"):
            inputs.append(self._client("action", topics))
        elif self.accept_word("server"):
            outputs.append(self._server("action", topics, served))
        else:
            raise self.fail(
                "`server` or `client` after `action`", "write `action server NAME` or `action client NAME : …`"
            )

    def _own_topic(self, port: syntax.Name, topics: list[syntax.OwnTopic]) -> None:
        if self.accept_word("as"):
            topics.append(syntax.OwnTopic(port, self.topic(f"the program's name for the topic of `{port.text}`")))

    def _tolerated(self) -> syntax.Number:
        number = self.number("a number of messages after `tolerates`")
        self.expect_word("missed", f"after `tolerates {number.span.text}`")
        if number.value >= 1 and number.value.is_integer():
            return number
        message = "the number of missed messages that an input tolerates must be a whole number of at least 1"
        self.reporter.report("E126", number.span, message, help="write for example `tolerates 3 missed`")
        return syntax.Number(1.0, number.span)

    def _output(self, topics: list[syntax.OwnTopic], lazy: list[syntax.Name]) -> syntax.Name:
        self.layout.marks[self.i] = "port"
        name = self.name("an output name", ("output", ":"))
        self._no_contract(name, "output")
        self._own_topic(name, topics)
        if self.at_word("lazy"):
            lazy.append(syntax.Name(name.text, self.span()))
            self.i += 1
        return name

    def _no_contract(self, name: syntax.Name, kind: str) -> None:
        """Report a contract in the declaration of an output."""
        if self.kinds[self.i] == ":":
            help = f"state it in the modes: `guarantee {name.text} : …`"
            message = f"the declaration of {kind} `{name.text}` cannot state a contract"
            self.reporter.report("E120", self.span(), message, help=help)
            self.i += 1
            self.contract(f"for {kind} `{name.text}`")

    def _allows(self) -> syntax.AllowedEndpoint:
        if self.kinds[self.i] == "string":
            kind = self.text("a kind of endpoint")
        elif self.at_word("ROS") and self.texts[self.i + 1] == "action":
            self.i += 2
            kind = syntax.Name("ROS action", self.span(self.i - 1))
        elif self.kinds[self.i] == "name":
            kind = self.take()
        else:
            raise self.fail("`topic`, `service` or `ROS action` after `allows`")
        if kind.text not in ENDPOINT_KINDS:
            help = 'write `"ROS action"`' if kind.text == "action" else 'use `topic`, `service` or `"ROS action"`'
            self.reporter.report("E120", kind.span, f"`{kind.text}` is not a kind of endpoint", help=help)
            kind = syntax.Name("service", kind.span)
        name = self.topic("an endpoint name")
        return syntax.AllowedEndpoint(kind.text, name)

    def _functionality(self, first: int) -> syntax.FunctionalityDeclaration:
        name = self.name("a functionality name", ("{",))
        weight = self.number("a weight") if self.accept_word("weight") else None
        uses: list[syntax.Name] = []
        produces: list[syntax.Name] = []
        modes: list[syntax.ModeDeclaration] = []

        handlers: Handlers = {
            "uses": lambda _: uses.extend(self.names("an input name")),
            "produces": lambda _: produces.extend(self.names("an output name")),
            "mode": lambda start: modes.append(self._mode(start)),
        }
        skipped = self.block(f"functionality `{name.text}`", first, handlers)
        incomplete = bool(skipped) or any(mode.incomplete for mode in modes)
        return syntax.FunctionalityDeclaration(name, weight, tuple(uses), tuple(produces), tuple(modes), incomplete)

    def _mode(self, first: int) -> syntax.ModeDeclaration:
        name = self.name("a mode name", ("{",))
        self.layout.marks[self.i] = "mode {"
        assumptions: list[syntax.AssumptionExpression] = []
        guarantees: list[syntax.GuaranteeStatement] = []
        parameters: list[syntax.ParameterEntry] = []
        unread: set[str] = set()
        handlers: Handlers = {
            "assume": lambda _: self._each("assume", assumptions, self._assumption),
            "guarantee": lambda _: self._each("guarantee", guarantees, self._guarantee),
            "parameters": lambda start: unread.update(self._mode_parameters(start, parameters)),
        }
        skipped = self.block(f"mode `{name.text}`", first, handlers)
        incomplete = bool(skipped or unread)
        return syntax.ModeDeclaration(name, tuple(assumptions), tuple(guarantees), tuple(parameters), incomplete)

    def _each(self, word: str, found: list[_Stated], parse: Callable[[], _Stated]) -> None:
        """One assumption or guarantee. Further ones after a comma or ``and`` are reported, and parsed as meant."""
        found.append(parse())
        while self.texts[self.i] in {",", "and"} and self._is_listed(word, self.i + 1):
            self.i += 1
            listed = self.texts[self.i]
            help = f"write `{word} {listed}{' : …' if word == 'guarantee' else ''}`"
            self.reporter.report("E120", self.span(), f"expected `{word}` before `{listed}`", help=help)
            found.append(parse())

    def _is_listed(self, word: str, at: int) -> bool:
        """Return whether a further assumption or guarantee begins here without its keyword."""
        if self.kinds[at] != "name" or self.is_keyword(at):
            return False
        if word == "guarantee":
            return self.kinds[at + 1] == ":"
        return nearest(self.texts[at], _MODE_WORDS) is None

    def _mode_parameters(self, start: int, parameters: list[syntax.ParameterEntry]) -> frozenset[str]:
        if self.kinds[self.i] == "string":
            raise self.fail("`{` after `parameters`", "a mode states its parameters here, not in a file")
        if self.at_word("for"):
            raise self.fail("`{` after `parameters`", "a mode sets the parameters of its own node")
        unread = self.parameters(start, parameters, [])
        for entry in parameters:
            if entry.changeable:
                help = "omit `changeable`"
                self.reporter.report("E120", entry.name.span, "a mode sets the value of a parameter only", help=help)
        return unread

    def _assumption(self) -> syntax.AssumptionExpression:
        start = self.i
        if self.kinds[start] != "name" or self.texts[start + 1] != "or" or self.kinds[start + 1] != "name":
            return self.contract("or an input name after `assume`")
        inputs = [self.name("an input name")]
        while self.accept_word("or"):
            inputs.append(self.name("an input name after `or`"))
        return syntax.NamedAssumption(tuple(inputs), self.since(start))

    def _guarantee(self) -> syntax.GuaranteeStatement:
        output = self.name("an output name", (":",))
        self.expect(":", f"after `{output.text}`", ("path",))
        contract = self.contract(f"for output `{output.text}`")
        return syntax.GuaranteeStatement(output, contract)
