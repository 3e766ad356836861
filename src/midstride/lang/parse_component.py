"""Parsing of components: command, resources, ports, functionalities and modes."""

from __future__ import annotations

from midstride.lang.parse_contract import ContractParser
from midstride.lang.syntax import (
    AllowedEndpoint,
    AssumptionExpression,
    ComponentDeclaration,
    ContractExpression,
    FunctionalityDeclaration,
    GuaranteeStatement,
    InputDeclaration,
    ModeDeclaration,
    Name,
    NamedAssumption,
    Number,
    ParameterEntry,
    ResourceUse,
    Run,
)
from midstride.lang.token_stream import RESERVED

ENDPOINT_KINDS = ("topic", "service", "ROS action")


class ComponentParser(ContractParser):
    """The part of the parser for components."""

    def component(self) -> ComponentDeclaration:
        first = self.i
        self.i += 1
        name = self.name("a component name", ("{",))
        like = None
        if self.accept_word("like"):
            like = self.name("a component name after `like`")
        runs: list[Run] = []
        holds: list[tuple[ResourceUse, ...]] = []
        parameters: list[ParameterEntry] = []
        files: list[Name] = []
        inputs: list[InputDeclaration] = []
        outputs: list[Name] = []
        allows: list[AllowedEndpoint] = []
        functionalities: list[FunctionalityDeclaration] = []
        lost_parameters: frozenset[str] = frozenset()

        def read_parameters() -> None:
            nonlocal lost_parameters
            lost_parameters |= self.parameters(parameters, files)

        skipped: frozenset[str] = frozenset()
        if like is None or self.kinds[self.i] == "{":
            skipped = self.block(
                f"component `{name.text}`",
                first,
                {
                    "run": lambda: runs.append(self._run()),
                    "holds": lambda: holds.append(self._holds()),
                    "parameters": read_parameters,
                    "input": lambda: inputs.append(self._input()),
                    "output": lambda: outputs.append(self._output()),
                    "allows": lambda: allows.append(self._allows()),
                    "functionality": lambda: functionalities.append(self._functionality()),
                },
            )
        if lost_parameters:
            skipped |= {"parameters"}
        return ComponentDeclaration(
            self.since(first),
            name,
            like,
            tuple(runs),
            tuple(holds),
            tuple(parameters),
            tuple(files),
            tuple(inputs),
            tuple(outputs),
            tuple(allows),
            tuple(functionalities),
            skipped,
        )

    def _run(self) -> Run:
        start = self.i
        self.i += 1
        if self.kinds[self.i] in {"name", "path"}:
            words = self.rest_of_line()
            raise self.fail("a command in double quotes after `run`", f'write `run "{words}"`')
        command = self.text("a command in double quotes after `run`")
        startup = self.seconds("a startup time") if self.accept_word("takes") else None
        return Run(command, startup, self.since(start))

    def _holds(self) -> tuple[ResourceUse, ...]:
        self.i += 1
        found: list[ResourceUse] = []
        if self.at_word("nothing"):
            self.i += 1
            return ()
        while True:
            resource = self.resource("a resource")
            amount: Number | None = None
            if self.kinds[self.i] == "number":
                amount = self.number("an amount")
            found.append(ResourceUse(resource, amount))
            at = self.i + (self.kinds[self.i] == ",")
            if self.kinds[at] not in {"name", "path", "string"} or (
                self.kinds[at] == "name" and self.texts[at] in RESERVED
            ):
                return tuple(found)
            self.i = at
            self.layout.items.add(at)

    def resource(self, what: str) -> Name:
        """A resource name or a device path, in double quotes or without."""
        return self.text(what) if self.kinds[self.i] == "string" else self.topic(what)

    def _input(self) -> InputDeclaration:
        self.i += 1
        self.layout.marks[self.i] = "port"
        name = self.name("an input name", (":",))
        self.layout.marks[self.i] = "input :"
        self.expect(":", f"after input `{name.text}`", ("name", "path"))
        return InputDeclaration(name, self.contract(f"for input `{name.text}`"))

    def _output(self) -> Name:
        self.i += 1
        self.layout.marks[self.i] = "port"
        name = self.name("an output name", ("output", ":"))
        if self.kinds[self.i] == ":":
            help = f"state it in the modes: `guarantee {name.text} : …`"
            message = f"the declaration of output `{name.text}` cannot state a contract"
            self.reporter.report("E120", self.span(), message, help=help)
            self.i += 1
            self.contract(f"for output `{name.text}`")
        return name

    def _allows(self) -> AllowedEndpoint:
        start = self.i
        self.i += 1
        if self.kinds[self.i] == "string":
            kind = self.text("a kind of endpoint")
        elif self.at_word("ROS") and self.texts[self.i + 1] == "action":
            self.i += 2
            kind = Name("ROS action", self.span(self.i - 1))
        elif self.kinds[self.i] == "name":
            self.i += 1
            kind = Name(self.texts[self.i - 1], self.span(self.i - 1))
        else:
            raise self.fail("`topic`, `service` or `ROS action` after `allows`")
        if kind.text not in ENDPOINT_KINDS:
            help = 'write `"ROS action"`' if kind.text == "action" else 'use `topic`, `service` or `"ROS action"`'
            self.reporter.report("E120", kind.span, f"`{kind.text}` is not a kind of endpoint", help=help)
            kind = Name("service", kind.span)
        name = self.topic("an endpoint name")
        return AllowedEndpoint(kind.text, name, self.since(start))

    # -- functionalities ---------------------------------------------------------------------------------

    def _functionality(self) -> FunctionalityDeclaration:
        first = self.i
        self.i += 1
        name = self.name("a functionality name", ("{",))
        weight: Number | None = None
        if self.accept_word("weight"):
            weight = self.number("a weight")
        uses: list[Name] = []
        produces: list[Name] = []
        modes: list[ModeDeclaration] = []

        def listed(found: list[Name], what: str) -> None:
            self.i += 1
            found.extend(self.names(what))

        skipped = self.block(
            f"functionality `{name.text}`",
            first,
            {
                "uses": lambda: listed(uses, "an input name"),
                "produces": lambda: listed(produces, "an output name"),
                "mode": lambda: modes.append(self._mode()),
            },
        )
        incomplete = bool(skipped) or any(mode.incomplete for mode in modes)
        return FunctionalityDeclaration(
            self.since(first), name, weight, tuple(uses), tuple(produces), tuple(modes), incomplete
        )

    def _mode(self) -> ModeDeclaration:
        first = self.i
        self.i += 1
        name = self.name("a mode name", ("{",))
        self.layout.marks[self.i] = "mode {"
        assumptions: list[AssumptionExpression] = []
        guarantees: list[GuaranteeStatement] = []
        skipped = self.block(
            f"mode `{name.text}`",
            first,
            {
                "assume": lambda: assumptions.append(self._assumption()),
                "guarantee": lambda: guarantees.append(self._guarantee()),
            },
        )
        return ModeDeclaration(self.since(first), name, tuple(assumptions), tuple(guarantees), bool(skipped))

    def _assumption(self) -> AssumptionExpression:
        self.i += 1
        start = self.i
        if self.kinds[start] != "name" or self.texts[start + 1] != "or" or self.kinds[start + 1] != "name":
            return self.contract("or an input name after `assume`")
        inputs = [self.name("an input name")]
        while self.accept_word("or"):
            inputs.append(self.name("an input name after `or`"))
        return NamedAssumption(tuple(inputs), self.since(start))

    def _guarantee(self) -> GuaranteeStatement:
        start = self.i
        self.i += 1
        output = self.name("an output name", (":",))
        self.expect(":", f"after `{output.text}`", ("path",))
        contract: ContractExpression | None = self.contract(f"for output `{output.text}`")
        return GuaranteeStatement(output, contract, self.since(start))
