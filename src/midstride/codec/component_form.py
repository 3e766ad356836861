"""The JSON forms of a component: its ports, parameters, functionalities and modes.

    {"run": "python3 -m demo.talker", "takes_seconds": 2, "holds": {"gpu_memory": 2048},
     "gate": "preload", "stop_seconds": {"sigterm": 10, "sigkill": 5},
     "parameters": {"threshold": {"value": 0.4, "changeable": true}},
     "allows": [{"kind": "service", "name": "~/reset"}],
     "inputs": {"in": {"type": …, "rate": 5, "tolerates": 3}}, "outputs": ["out"],
     "functionalities": {"talk": {"weight": 3, "uses": ["in"], "produces": ["out"], "modes": {
         "normal":   {"assumes": ["in", {"any_of": ["left", "right"]}, {"type": …}],
                      "guarantees": {"out": {"type": …, "rate": 10}}},
         "degraded": {}}}}}

The order of ``modes`` is their rank, best first, and that of ports and functionalities is that of their declaration:
do not sort keys.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, TypeAlias

import msgspec
from immutables import Map
from msgspec import UNSET, Meta, UnsetType

from midstride.codec.contract_form import (
    AnyType,
    PredicateForm,
    QoSForm,
    Rate,
    WhereForm,
    WithinForm,
    predicate_keys,
)
from midstride.codec.form import (
    LARGEST,
    Document,
    Form,
    HostName,
    NonEmptyName,
    PositiveSeconds,
    SecondsOrZero,
    Shape,
    ShapedForm,
    by_name,
    encode,
    field,
    given,
    named,
    plain,
    stated,
)
from midstride.codec.parameter import ParameterForm, ValueForm, values_form, values_of
from midstride.codec.reading import decode
from midstride.errors import SpecificationError
from midstride.model.component import (
    DEFAULT_CONTAINER,
    DEFAULT_STOP,
    Assumption,
    ComponentSpec,
    ContainerProgram,
    FunctionalitySpec,
    Gate,
    InputAlternatives,
    Mode,
    NodeEndpoint,
    StopTimes,
)
from midstride.model.contract import Predicate
from midstride.model.hosts import OWN_HOST
from midstride.model.name_checks import component_names

InputNames: TypeAlias = Annotated[list[NonEmptyName], field("a list of names of inputs", "its inputs")]
OutputNames: TypeAlias = Annotated[list[NonEmptyName], field("a list of names of outputs", "its outputs")]


class EndpointForm(Form, frozen=True):
    """An endpoint of the node that is not a port."""

    what: ClassVar[str] = "an allowed endpoint"

    kind: Literal["topic", "service", "action"]
    name: Annotated[str, field("the name of an endpoint", min_length=1)]


class InputForm(PredicateForm, frozen=True):
    """The assumptions of an input about its topics, the missed messages it tolerates, and whether it is a condition."""

    what: ClassVar[str] = "an input"

    tolerates: Annotated[int, field("a number of messages", "missed in succession", ge=1)] | UnsetType = UNSET
    condition: Annotated[bool, field("true or false", "whether its last message decides")] = False


class AssumptionForm(ShapedForm, frozen=True):
    """One of several inputs, or what a message of some input must be like."""

    what: ClassVar[str] = "an assumption (the name of an input, an object with any_of, or a predicate)"
    shapes: ClassVar[tuple[Shape, ...]] = (Shape("an assumption of inputs", ("any_of",)),)
    otherwise: ClassVar[Shape] = Shape("a predicate", ("type",), ("rate", "qos", "where", "within_seconds"))

    any_of: Annotated[list[NonEmptyName], field("names of inputs", "one of these inputs", min_length=1)] | UnsetType = (
        UNSET
    )
    type: AnyType | UnsetType = UNSET
    rate: Rate | UnsetType = UNSET
    qos: QoSForm | UnsetType = UNSET
    where: WhereForm | UnsetType = UNSET
    within: WithinForm | UnsetType = msgspec.field(default=UNSET, name="within_seconds")

    @classmethod
    def of(cls, assumption: Assumption) -> AssumptionForm | str:
        if isinstance(assumption, Predicate):
            return cls(**predicate_keys(assumption))
        if len(assumption.inputs) == 1:
            return assumption.inputs[0]
        return cls(any_of=list(assumption.inputs))

    def assumption(self) -> Assumption:
        if self.any_of is not UNSET:
            return InputAlternatives(tuple(self.any_of))
        return PredicateForm(given(self.type), self.rate, self.qos, self.where, self.within).predicate()


AnyAssumption: TypeAlias = Annotated[
    Annotated[str, field("the name of an input", min_length=1)] | AssumptionForm, field(AssumptionForm.what)
]


class ModeForm(Form, frozen=True):
    """A mode: what it assumes, and what it then guarantees on outputs; those left out produce nothing."""

    what: ClassVar[str] = "a mode"

    assumes: Annotated[list[AnyAssumption], field("a list of assumptions")] = []
    guarantees: Annotated[dict[str, PredicateForm], field("an object of guarantees", "by output")] = {}
    parameters: Annotated[
        dict[str, ValueForm], field("an object of values", "the parameters that are set on entry")
    ] = {}

    @classmethod
    def of(cls, mode: Mode, functionality: FunctionalitySpec) -> ModeForm:
        order = {name: index for index, name in enumerate(functionality.outputs)}
        outputs = sorted(mode.guarantees, key=lambda name: (order.get(name, len(order)), name))
        return cls(
            assumes=[AssumptionForm.of(assumption) for assumption in mode.assumptions],
            guarantees={name: PredicateForm.of(mode.guarantees[name]) for name in outputs},
            parameters=values_form(mode.parameters),
        )

    def mode(self, name: str) -> Mode:
        assumptions = (
            InputAlternatives((assumed,)) if isinstance(assumed, str) else assumed.assumption()
            for assumed in self.assumes
        )
        guarantees = {output: guarantee.predicate() for output, guarantee in self.guarantees.items()}
        return Mode(name, tuple(assumptions), Map(guarantees), values_of(self.parameters))


class FunctionalityForm(Form, frozen=True, kw_only=True):
    """A computation from inputs to outputs, with its chain of modes."""

    what: ClassVar[str] = "a functionality"

    weight: Annotated[float, field("a weight", "how much its loss matters", ge=0, le=LARGEST)] | UnsetType = UNSET
    uses: InputNames = []
    produces: OutputNames = []
    modes: Annotated[dict[str, ModeForm], by_name("an object of modes", "its modes, best first")]

    @classmethod
    def of(cls, functionality: FunctionalitySpec) -> FunctionalityForm:
        return cls(
            weight=UNSET if functionality.weight == 1 else plain(functionality.weight),
            uses=list(functionality.inputs),
            produces=list(functionality.outputs),
            modes={mode.name: ModeForm.of(mode, functionality) for mode in functionality.modes},
        )

    def functionality(self, name: str) -> FunctionalitySpec:
        return FunctionalitySpec(
            name,
            modes=tuple(mode.mode(mode_name) for mode_name, mode in self.modes.items()),
            inputs=tuple(self.uses),
            outputs=tuple(self.produces),
            weight=1.0 if self.weight is UNSET else self.weight,
        )


class StopForm(Form, frozen=True):
    """The way to end a program without Midstride's API: with SIGINT, after a time SIGTERM, after another SIGKILL.

    A signal that has 0 s to take effect is not sent.
    """

    what: ClassVar[str] = "an object of times"

    sigterm: Annotated[SecondsOrZero, Meta(description="how long after SIGINT")] = DEFAULT_STOP.sigterm
    sigkill: Annotated[SecondsOrZero, Meta(description="how long after SIGTERM")] = DEFAULT_STOP.sigkill
    drain: Annotated[SecondsOrZero, Meta(description="how long it answers what it has taken")] = DEFAULT_STOP.drain
    patience: Annotated[SecondsOrZero, Meta(description="how long its goals may take to end")] = DEFAULT_STOP.patience

    @classmethod
    def of(cls, stop: StopTimes) -> StopForm:
        return cls(
            sigterm=plain(stop.sigterm),
            sigkill=plain(stop.sigkill),
            drain=plain(stop.drain),
            patience=plain(stop.patience),
        )

    def times(self) -> StopTimes:
        return StopTimes(float(self.sigterm), float(self.sigkill), float(self.drain), float(self.patience))


class ContainerForm(Form, frozen=True):
    """The program that loads a composable node."""

    what: ClassVar[str] = "a container program"

    run: Annotated[str, field("a command", "an executable of its package", min_length=1)] = DEFAULT_CONTAINER.run
    package: Annotated[str, field("a package", "its package", min_length=1)] = DEFAULT_CONTAINER.package

    @classmethod
    def of(cls, program: ContainerProgram) -> ContainerForm:
        return cls(program.run, program.package)

    def program(self) -> ContainerProgram:
        return ContainerProgram(self.run, self.package)


Prefix: TypeAlias = Annotated[str, field("a command", "the words before its program", min_length=1)]
Environment: TypeAlias = Annotated[
    dict[str, str | None],
    field("an object of variables", "variables of its process; null: not inherited"),
]


class SharedProgramForm(ContainerForm, frozen=True):
    """The program of a container that several nodes share, with how its process is started and ended."""

    prefix: Prefix | UnsetType = UNSET
    environment: Environment = {}
    takes_seconds: SecondsOrZero | UnsetType = UNSET
    stop_seconds: StopForm | UnsetType = UNSET
    host: HostName = OWN_HOST

    @classmethod
    def of(cls, program: ContainerProgram) -> SharedProgramForm:
        return cls(
            program.run,
            program.package,
            program.prefix or UNSET,
            dict(sorted(program.environment.items())),
            stated(program.startup_seconds),
            UNSET if program.stop is None else StopForm.of(program.stop),
            program.host,
        )

    def program(self) -> ContainerProgram:
        stop = None if self.stop_seconds is UNSET else self.stop_seconds.times()
        environment = Map(self.environment)
        takes = given(self.takes_seconds)
        return ContainerProgram(self.run, self.package, given(self.prefix), environment, takes, stop, self.host)


class ComponentForm(Form, frozen=True):
    """A component, whose name is the key it is under."""

    what: ClassVar[str] = "a component"

    run: Annotated[str, field("a command", "the command that starts it; none: started elsewhere")] | UnsetType = UNSET
    package: Annotated[str, field("a package", "the ROS 2 package of its program", min_length=1)] | UnsetType = UNSET
    container: Annotated[ContainerForm, Meta(description="`run` is a class that this loads")] | UnsetType = UNSET
    prefix: Prefix | UnsetType = UNSET
    environment: Environment = {}
    takes_seconds: SecondsOrZero | UnsetType = UNSET
    activate_seconds: (
        Annotated[PositiveSeconds, Meta(description="how long a lifecycle node may take to activate")] | UnsetType
    ) = UNSET
    stop_seconds: StopForm | UnsetType = UNSET
    holds: Annotated[
        dict[str, Annotated[float, field("an amount", gt=0, le=LARGEST)]],
        field("an object of amounts", "what it holds of resources"),
    ] = {}
    parameters: Annotated[dict[str, ParameterForm], field("an object of parameters", "its parameters")] = {}
    allows: Annotated[list[EndpointForm], field("a list of endpoints", "endpoints that are not ports")] = []
    inputs: Annotated[dict[str, InputForm], by_name("an object of inputs", "its assumption on each input")] = {}
    outputs: Annotated[
        list[Annotated[str, Meta(min_length=1, extra_json_schema=named())]],
        field("a list of names of outputs", "the names of its outputs"),
    ] = []
    functionalities: Annotated[
        dict[str, FunctionalityForm], by_name("an object of functionalities", "what it does")
    ] = {}
    gate: Annotated[Gate, field("a gate", "what holds it back; none: it uses Midstride's API")] | UnsetType = UNSET
    once: Annotated[bool, field("true or false", "its program ends when it has done its work")] = False
    unnamed: Annotated[bool, field("true or false", "whether its program gives its node its name itself")] = False
    renames: (
        Annotated[
            str, Meta(min_length=1, extra_json_schema=named()), field("the name of a node", "what its program calls it")
        ]
        | UnsetType
    ) = UNSET
    topics: Annotated[
        dict[str, Annotated[str, field("the name of a topic", min_length=1)]],
        field("an object of names of topics", "what its program calls the topics of its ports"),
    ] = {}
    lazy: Annotated[
        list[Annotated[str, Meta(min_length=1, extra_json_schema=named())]],
        field("a list of names of outputs", "the outputs that exist only while something subscribes to them"),
    ] = []

    @classmethod
    def of(cls, component: ComponentSpec) -> ComponentForm:
        return cls(
            run=component.run or UNSET,
            package=component.package or UNSET,
            container=UNSET if component.container is None else ContainerForm.of(component.container),
            prefix=component.prefix or UNSET,
            environment=dict(sorted(component.environment.items())),
            takes_seconds=stated(component.startup_seconds),
            activate_seconds=stated(component.activate_seconds),
            stop_seconds=UNSET if component.stop is None else StopForm.of(component.stop),
            holds={name: plain(amount) for name, amount in sorted(component.resource_usage.items())},
            parameters={name: ParameterForm.of(parameter) for name, parameter in sorted(component.parameters.items())},
            allows=[msgspec.convert(endpoint, EndpointForm, from_attributes=True) for endpoint in component.allows],
            inputs={
                name: InputForm(
                    **predicate_keys(component.inputs[name]),
                    tolerates=component.tolerates.get(name, UNSET),
                    condition=name in component.conditions,
                )
                for name in component.input_order
            },
            outputs=list(component.outputs),
            functionalities={form.name: FunctionalityForm.of(form) for form in component},
            gate=UNSET if component.once and component.gate == "none" else component.gate or UNSET,
            once=component.once,
            unnamed=component.unnamed,
            renames=component.renames or UNSET,
            topics=dict(sorted(component.topics.items())),
            lazy=sorted(component.lazy),
        )

    def component(self, name: str) -> ComponentSpec:
        """The component under that name; the names in it are not checked. Raises ValueError as ``value_of``."""
        return ComponentSpec.of(
            name,
            inputs={port: assumption.predicate() for port, assumption in self.inputs.items()},
            outputs=tuple(self.outputs),
            functionalities=tuple(form.functionality(key) for key, form in self.functionalities.items()),
            resource_usage=self.holds,
            parameters={key: form.parameter() for key, form in self.parameters.items()},
            allows=tuple(NodeEndpoint(endpoint.kind, endpoint.name) for endpoint in self.allows),
            run=given(self.run),
            package=given(self.package),
            container=None if self.container is UNSET else self.container.program(),
            prefix=given(self.prefix),
            environment=self.environment,
            startup_seconds=given(self.takes_seconds),
            tolerates={port: form.tolerates for port, form in self.inputs.items() if form.tolerates is not UNSET},
            conditions=[port for port, form in self.inputs.items() if form.condition],
            gate=given(self.gate) or ("none" if self.once else None),
            once=self.once,
            unnamed=self.unnamed,
            renames=given(self.renames),
            topics=self.topics,
            activate_seconds=given(self.activate_seconds),
            stop=None if self.stop_seconds is UNSET else self.stop_seconds.times(),
            lazy=self.lazy,
        )


class NamedComponentForm(ComponentForm, frozen=True, kw_only=True):
    """A component by itself, its name in it: what a node registers."""

    name: Annotated[str, field("a name", min_length=1, extra_json_schema=named())]

    @classmethod
    def of(cls, component: ComponentSpec) -> NamedComponentForm:
        return cls(name=component.name, **msgspec.structs.asdict(ComponentForm.of(component)))

    def declared(self) -> ComponentSpec:
        """The component, without a check of its names. Raises ValueError as ``value_of``."""
        return self.component(self.name)

    def checked(self) -> ComponentSpec:
        """The component. Raises SpecificationError with every fault in its names and values."""
        try:
            component = self.declared()
        except ValueError as error:
            raise SpecificationError(f"component {self.name}: {error}") from None
        if faults := component_names(component, ()):
            raise SpecificationError(faults)
        return component


def decode_component(document: object) -> ComponentSpec:
    """The component that a document with a ``name`` declares. Raises SpecificationError with every fault in it."""
    return decode(document, NamedComponentForm, NamedComponentForm.declared, lambda found: component_names(found, ()))


def encode_component(component: ComponentSpec) -> Document:
    """The document of one component by itself, its name first."""
    return {"name": component.name, **encode(ComponentForm.of(component))}
