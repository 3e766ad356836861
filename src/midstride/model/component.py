"""The declaration of a component: ports, functionalities with their modes, resources, parameters.

A component is a *type*, such as "a lidar driver"; what runs is an
:class:`~midstride.model.configuration.Instance` of it. It has input and output ports, which are attached to topics
(here: connectors), and functionalities, the computations between them. Each functionality has several modes, best
first: a mode assumes something of the inputs and guarantees something on the outputs in return. The last mode assumes
nothing, so a functionality that loses its inputs can always degrade to it instead of failing
(docs/semantics.md section 2; the paper's sections 3.2 and 4.2).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Final, Literal, NamedTuple, TypeAlias, get_args

from immutables import Map

from midstride.model.contract import NOTHING, ConnectorKind, Contract, Predicate, QoS, connector_kind
from midstride.model.hosts import OWN_HOST, resource_key
from midstride.model.wording import KIND_WORDS

ParameterValue: TypeAlias = "bool | int | float | str | list[bool] | list[int] | list[float] | list[str]"

# What every node of ROS 2 has: it may be set for a node although its component does not declare it.
ROS_PARAMETERS: Final[Mapping[str, ParameterValue]] = {"use_sim_time": False}

# What holds back the outputs of a program that does not use Midstride's API: a preloaded library, a process that passes
# on its messages, the lifecycle of its ROS 2 node, with or without that library, or nothing. With `lifecycle` alone,
# the library hands over the requests to its services, and holds back no outputs.
Gate: TypeAlias = Literal["preload", "relay", "lifecycle", "lifecycle preload", "none"]
GATES: Final[tuple[Gate, ...]] = get_args(Gate)


@dataclass(frozen=True, slots=True)
class StopTimes:
    """The times for ending a process: SIGINT, after ``sigterm`` s SIGTERM, after ``sigkill`` s more SIGKILL.

    A signal that has 0 s to take effect is not sent. The defaults are those of ROS's own `launch`. Before that, a node
    with the preloaded library answers the requests to its services that it has taken, for ``drain`` s from when its
    replacement is to answer, and for as long again once it is to end. It continues the goals of its ROS actions
    until these have ended, for ``patience`` s at most. One that has been ``asked`` to end before is first waited for so
    long (s), without a signal: the second one would end it at once. ``whole``: all that share its process are to end.
    """

    sigterm: float = 5.0
    sigkill: float = 5.0
    drain: float = 2.0
    patience: float = 60.0
    asked: float = 0.0
    whole: bool = False

    @property
    def longest(self) -> float:
        """The longest time until the process has ended or is killed (s)."""
        return self.sigterm + self.sigkill


DEFAULT_STOP: Final = StopTimes()
# How long a node has to end the goals that are cancelled when its patience is over, then its clients to fetch the
# results, and then the node to give those that no client has fetched (s).
CANCELLING: Final = 3.0
# For a process that must not run again, not for an instant.
KILL_AT_ONCE: Final = StopTimes(0.0, 0.0)


@dataclass(frozen=True, slots=True)
class ContainerProgram:
    """The program that loads a composable node: ``run`` is an executable of ``package``, with its arguments.

    The rest is of a container that several nodes share, and of each of its processes; a node without one states that in
    its component. ``prefix``: the words before the program. ``environment``: the variables that it has besides, None
    for one that it does not inherit. ``startup_seconds``: how long it takes to start, before it loads a node.
    ``stop``: how it is ended, once its last node leaves. ``host``: the one that it runs on.
    """

    run: str = "component_container"
    package: str = "rclcpp_components"
    prefix: str | None = None
    environment: Map[str, str | None] = field(default_factory=Map)
    startup_seconds: float | None = None
    stop: StopTimes | None = None
    host: str = OWN_HOST

    def same_process(self, other: ContainerProgram) -> bool:
        """Return whether the two start the same process, however long that takes to start and to end."""
        own, theirs = ((each.run, each.package, each.prefix, each.environment, each.host) for each in (self, other))
        return own == theirs


DEFAULT_CONTAINER: Final = ContainerProgram()

_KINDS: Final[Mapping[type, str]] = {bool: "boolean", int: "integer", float: "float", str: "string"}


def value_kind(value: ParameterValue) -> str:
    """The type of a parameter's value, in words."""
    if isinstance(value, list):
        return f"a list of {_KINDS[type(value[0])]}s" if value else "an empty list"
    kind = _KINDS[type(value)]
    return f"{'an' if kind == 'integer' else 'a'} {kind}"


def value_fits(value: ParameterValue, declared: ParameterValue) -> bool:
    """Return whether a parameter declared with one value accepts another: an integer is accepted for a float."""
    if isinstance(declared, list):
        return isinstance(value, list) and (not declared or all(value_fits(member, declared[0]) for member in value))
    return type(value) is type(declared) or (type(value) is int and type(declared) is float)


def canonical(value: Any) -> Any:
    """The value of a parameter with ``math.nan`` for any NaN in it: as one object, it is equal to itself in containers.

    Whatever reads values from outside, of files, JSON or ROS, calls this.
    """
    if isinstance(value, list):
        return [canonical(member) for member in value]
    return math.nan if isinstance(value, float) and math.isnan(value) else value


def same_value(first: object, second: object) -> bool:
    """Return whether two values of a parameter are equal.

    NaN is equal to itself here: else it would always count as changed.
    """
    if isinstance(first, list) and isinstance(second, list):
        return len(first) == len(second) and all(map(same_value, first, second))
    return bool(first == second) or (first != first and second != second)


@dataclass(frozen=True, slots=True)
class ParameterSection:
    """A section of a parameter file that may be for further nodes in the process of a node.

    ``pattern`` is the name of the section, which rcl matches to nodes.
    """

    pattern: str
    parameters: Map[str, ParameterValue] = field(default_factory=Map)

    def matches(self, node: str) -> bool:
        """Return whether it applies to the node of this full name, as in rclcpp and rclpy."""
        return _section_regex(self.pattern).fullmatch("/" + node.strip("/")) is not None


@dataclass(frozen=True, slots=True)
class SharedContainer:
    """A container that several composable nodes of a system share: its name, with the namespaces, and its program.

    ``sections``: parameters of the nodes that its components make themselves, which read what its process is given.
    """

    name: str
    program: ContainerProgram = DEFAULT_CONTAINER
    sections: tuple[ParameterSection, ...] = ()


@lru_cache(maxsize=4096)
def _section_regex(pattern: str) -> re.Pattern[str]:
    # `/**` is a repetition because its first two characters alone are replaced.
    full = pattern if pattern.startswith("/") else f"/{pattern}"
    return re.compile(full.replace("/*", r"(/\w+)"), re.ASCII)


class PortRef(NamedTuple):
    """A port of an instance, written ``talker.out``."""

    instance: str
    port: str

    def __str__(self) -> str:
        return f"{self.instance}.{self.port}"

    @classmethod
    def parse(cls, text: str) -> PortRef:
        component, _, port = text.rpartition(".")
        return cls(component, port)


class FunctionalityRef(NamedTuple):
    """A functionality of an instance (or, in constraints and reports, of a role): ``talker.talk``."""

    instance: str
    functionality: str

    def __str__(self) -> str:
        return f"{self.instance}.{self.functionality}"

    @classmethod
    def parse(cls, text: str) -> FunctionalityRef:
        component, _, functionality = text.rpartition(".")
        return cls(component, functionality)


@dataclass(frozen=True, slots=True)
class InputAlternatives:
    """An assumption that names its inputs: one of them is satisfied, each by its own assumption."""

    inputs: tuple[str, ...]

    def __str__(self) -> str:
        return " or ".join(self.inputs)


Assumption: TypeAlias = InputAlternatives | Predicate


@dataclass(frozen=True, slots=True)
class Mode:
    """One way of working: what it assumes, and what it then guarantees on each associated output.

    ``parameters`` are set on entry, where the program does not use Midstride's API.
    """

    name: str
    assumptions: tuple[Assumption, ...] = ()
    guarantees: Map[str, Predicate] = field(default_factory=Map)
    parameters: Map[str, ParameterValue] = field(default_factory=Map)

    def guarantee(self, output: str) -> Contract:
        """The guarantee for ``output``; one that is not stated is ``nothing``."""
        return self.guarantees.get(output, NOTHING)

    def needs(self) -> frozenset[Predicate | frozenset[str]]:
        """The needs of the mode, regardless of the order of declaration: predicates, and inputs that are
        alternatives.
        """
        return frozenset(frozenset(a.inputs) if isinstance(a, InputAlternatives) else a for a in self.assumptions)


@dataclass(frozen=True, slots=True)
class FunctionalitySpec:
    """A computation from associated inputs to associated outputs, with its chain of modes, best first.

    ``modes[0]`` is the normal mode, ``modes[-1]`` the degraded one. ``weight`` says how much its
    loss matters.
    """

    name: str
    modes: tuple[Mode, ...]
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    weight: float = 1.0

    @property
    def last_mode(self) -> int:
        return len(self.modes) - 1

    def mode_index(self, name: str) -> int:
        """The index of the mode ``name`` in the chain (0 = normal). Raises KeyError for an unknown one."""
        for index, mode in enumerate(self.modes):
            if mode.name == name:
                return index
        raise KeyError(name)

    def mode_parameters(self) -> frozenset[str]:
        """The names of the parameters that any mode sets."""
        return frozenset(name for mode in self.modes for name in mode.parameters)

    def on_entry(self, mode: Mode, values: Mapping[str, ParameterValue]) -> dict[str, ParameterValue]:
        """The values that are set when ``mode`` is entered; where it states none, the node's own ``values``.

        The last mode sets nothing unless it states something, so that degrading to it cannot be refused.
        """
        if mode is self.modes[-1] and not mode.parameters:
            return {}
        return {name: mode.parameters.get(name, values[name]) for name in sorted(self.mode_parameters())}

    def meaning(self) -> tuple[object, ...]:
        """Everything it declares, regardless of the order of its ports and assumptions."""
        modes = tuple((mode.name, mode.needs(), mode.guarantees, mode.parameters) for mode in self.modes)
        return self.name, self.weight, frozenset(self.inputs), frozenset(self.outputs), modes


@dataclass(frozen=True, slots=True)
class ParameterSpec:
    """A parameter's value, and whether it can be set while the component runs or only by replacing it."""

    value: ParameterValue
    changeable: bool = False

    def __eq__(self, other: object) -> bool:
        """Compare as :func:`same_value`: from Python 3.13 on, dataclasses do not take an object for equal to itself."""
        if not isinstance(other, ParameterSpec):
            return NotImplemented
        return self.changeable == other.changeable and same_value(self.value, other.value)


@dataclass(frozen=True, slots=True)
class NodeEndpoint:
    """An endpoint of a node that is accepted although it is not a port (``allows service ~/reset``)."""

    kind: str
    name: str

    def __str__(self) -> str:
        return f"{self.kind} {self.name}"


@dataclass(frozen=True, slots=True)
class ComponentSpec:
    """A component type. Two are the same implementation iff their *bodies* are equal, whatever the names.

    ``run`` is the command that starts it (None: it is started elsewhere), ``package`` the ROS 2 package of which its
    program is an executable, if any, ``prefix`` the words before the program, such as `nice`, and ``environment`` the
    variables that its process has besides, None for one that it does not inherit. ``startup_seconds``: how long the
    start takes (s), where known. ``tolerates``: how many missed messages in succession an input tolerates, where
    stated; ``conditions``: the inputs whose last message decides whether what they assume holds.
    ``gate``: what holds back the outputs of a program that does not use Midstride's API (None: it does use it);
    ``unnamed``: such a program gives its node its name itself, and is not passed one; ``renames``: what it calls the
    node that is to be named, where its process has others, which keep their names; and
    ``topics`` the names that such a program has for its ports, where they are not the ports' own. Of such a program,
    ``stop`` is how it is ended, ``activate_seconds`` how long a lifecycle node may take to become active (s), where
    stated, and ``lazy`` are the outputs that exist only while something subscribes to them.
    ``once``: such a program ends when it has done its work; it has no ports, and exit status 0 is success.
    ``container``: its node is composable, and that program loads it into its own process; ``run`` then begins
    with the class of ``package`` (:class:`.load_words.LoadWords`).
    """

    name: str
    inputs: Map[str, Predicate] = field(default_factory=Map)
    outputs: tuple[str, ...] = ()
    functionalities: Map[str, FunctionalitySpec] = field(default_factory=Map)
    input_order: tuple[str, ...] = ()
    functionality_order: tuple[str, ...] = ()
    resource_usage: Map[str, float] = field(default_factory=Map)
    parameters: Map[str, ParameterSpec] = field(default_factory=Map)
    allows: tuple[NodeEndpoint, ...] = ()
    run: str | None = None
    startup_seconds: float | None = None
    tolerates: Map[str, int] = field(default_factory=Map)
    conditions: frozenset[str] = frozenset()
    gate: Gate | None = None
    unnamed: bool = False
    renames: str | None = None
    topics: Map[str, str] = field(default_factory=Map)
    package: str | None = None
    prefix: str | None = None
    environment: Map[str, str | None] = field(default_factory=Map)
    stop: StopTimes | None = None
    activate_seconds: float | None = None
    lazy: frozenset[str] = frozenset()
    once: bool = False
    container: ContainerProgram | None = None
    _owners: dict[str, FunctionalitySpec] = field(init=False, compare=False, repr=False)
    _users: dict[str, list[FunctionalitySpec]] = field(init=False, compare=False, repr=False)
    _outputs: frozenset[str] = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        owners: dict[str, FunctionalitySpec] = {}
        users: dict[str, list[FunctionalitySpec]] = {}
        for functionality in self:
            for output in functionality.outputs:
                owners.setdefault(output, functionality)
            for name in dict.fromkeys(functionality.inputs):
                users.setdefault(name, []).append(functionality)
        object.__setattr__(self, "_owners", owners)
        object.__setattr__(self, "_users", users)
        object.__setattr__(self, "_outputs", frozenset(self.outputs))

    @classmethod
    def of(
        cls,
        name: str,
        *,
        inputs: Mapping[str, Predicate] | None = None,
        outputs: tuple[str, ...] = (),
        functionalities: tuple[FunctionalitySpec, ...] = (),
        resource_usage: Mapping[str, float] | None = None,
        parameters: Mapping[str, ParameterSpec] | None = None,
        allows: tuple[NodeEndpoint, ...] = (),
        run: str | None = None,
        startup_seconds: float | None = None,
        tolerates: Mapping[str, int] | None = None,
        conditions: Iterable[str] = (),
        gate: Gate | None = None,
        unnamed: bool = False,
        renames: str | None = None,
        topics: Mapping[str, str] | None = None,
        package: str | None = None,
        prefix: str | None = None,
        environment: Mapping[str, str | None] | None = None,
        stop: StopTimes | None = None,
        activate_seconds: float | None = None,
        lazy: Iterable[str] = (),
        once: bool = False,
        container: ContainerProgram | None = None,
    ) -> ComponentSpec:
        """Build one from plain values, keeping the order of declaration."""
        inputs = inputs or {}
        return cls(
            name=name,
            inputs=Map(inputs),
            outputs=tuple(outputs),
            functionalities=Map({functionality.name: functionality for functionality in functionalities}),
            input_order=tuple(inputs),
            functionality_order=tuple(functionality.name for functionality in functionalities),
            resource_usage=Map(resource_usage or {}),
            parameters=Map(parameters or {}),
            allows=tuple(allows),
            run=run,
            startup_seconds=startup_seconds,
            tolerates=Map(tolerates or {}),
            conditions=frozenset(conditions),
            gate=gate,
            unnamed=unnamed,
            renames=renames,
            topics=Map(topics or {}),
            package=package,
            prefix=prefix,
            environment=Map(environment or {}),
            stop=stop,
            activate_seconds=activate_seconds,
            lazy=frozenset(lazy),
            once=once,
            container=container,
        )

    def __iter__(self) -> Iterator[FunctionalitySpec]:
        """The functionalities, in order of declaration."""
        return (self.functionalities[name] for name in self.functionality_order)

    @property
    def preloads(self) -> bool:
        """Return whether a preloaded library holds back what the program publishes."""
        return self.gate in ("preload", "lifecycle preload")

    @property
    def loads_library(self) -> bool:
        """Return whether the library is loaded into the process of the program: for its outputs and services, or for
        its services alone.
        """
        return self.preloads or self.gate == "lifecycle"

    @property
    def has_agent(self) -> bool:
        """Return whether the component's process carries out commands itself: its program uses Midstride's API, or a
        relay runs it.
        """
        return self.gate in (None, "relay")

    @property
    def keeps_lease(self) -> bool:
        """Return whether its outputs fall silent once a lease is over, and nothing else of it is left to be heard."""
        return self.gate is None and not any(map(self.is_service, self.outputs))

    @property
    def counts_messages(self) -> bool:
        """Return whether it is known what the component's nodes publish and receive: by their own count, or by that
        of a gate.
        """
        return self.has_agent or self.preloads

    @property
    def has_lifecycle(self) -> bool:
        """Return whether the component's ROS 2 node is a lifecycle node, which is active in all modes but the last."""
        return self.gate in ("lifecycle", "lifecycle preload")

    @property
    def stop_times(self) -> StopTimes:
        """The times for ending its program: as it states, else as ROS's own `launch` does."""
        return self.stop or DEFAULT_STOP

    def topic_of(self, port: str) -> str:
        """The name that a program without Midstride's API has for the topic of ``port``."""
        return self.topics.get(port, port)

    def has_output(self, name: str) -> bool:
        return name in self._outputs

    def owner(self, output: str) -> FunctionalitySpec:
        """The one functionality that owns ``output``. Raises KeyError where there is none."""
        return self._owners[output]

    def find_owner(self, output: str) -> FunctionalitySpec | None:
        """The owner of ``output``, or None: for declarations that have not been checked yet."""
        return self._owners.get(output)

    def users(self, input_name: str) -> list[FunctionalitySpec]:
        """The functionalities associated with ``input_name``, in order of declaration."""
        return self._users.get(input_name, [])

    def output_endpoint(self, output: str) -> tuple[str, QoS] | None:
        """The type and QoS of the real endpoint (rule M3), or None where no mode guarantees anything."""
        stated = (mode.guarantees.get(output) for mode in self.owner(output).modes)
        return next(((guarantee.type, guarantee.qos) for guarantee in stated if guarantee is not None), None)

    def type_of(self, port: str) -> str | None:
        """The message type of a port; None where no mode guarantees anything for an output."""
        if port in self.inputs:
            return self.inputs[port].type
        endpoint = self.output_endpoint(port)
        return None if endpoint is None else endpoint[0]

    def kind_of(self, port: str) -> ConnectorKind:
        """The kind of connector that a port belongs to; an output that guarantees nothing in any mode is a topic's."""
        if port not in self.inputs and self.find_owner(port) is None:
            return "topic"
        return connector_kind(self.type_of(port) or "")

    def port_in_words(self, port: str) -> str:
        """``input scan``, ``server map``"""
        words = KIND_WORDS[self.kind_of(port)]
        return f"{words.input if port in self.inputs else words.output} {port}"

    def service_ports(self) -> list[str]:
        """The servers and clients of services and ROS actions, as :meth:`ports` orders them."""
        return [port for port in self.ports() if self.is_service(port)]

    def is_service(self, port: str) -> bool:
        """Return whether a port is a server or a client, of a service or ROS action."""
        return self.kind_of(port) != "topic"

    def stated_rate(self, port: str, modes: Mapping[str, str]) -> float | None:
        """The rate (Hz) that an input assumes, or that an output guarantees in the mode of its functionality.

        ``modes``: the current mode of each functionality. None where no rate is stated.
        """
        contract = self._stated(port, modes)
        return contract.rate if isinstance(contract, Predicate) else None

    def stated_bound(self, port: str, modes: Mapping[str, str]) -> float | None:
        """The bound (s) that a client assumes, or that a server guarantees in the mode of its functionality.

        ``modes``: the current mode of each functionality. None where no bound is stated.
        """
        contract = self._stated(port, modes)
        return contract.within if isinstance(contract, Predicate) else None

    def _stated(self, port: str, modes: Mapping[str, str]) -> Contract:
        """The contract that an input assumes, or an output guarantees, in the mode of its functionality."""
        if (owner := self.find_owner(port)) is not None:
            return next((mode.guarantee(port) for mode in owner.modes if mode.name == modes.get(owner.name)), NOTHING)
        return self.inputs.get(port, NOTHING)

    def ports(self) -> list[str]:
        """Every port, outputs first, in order of declaration."""
        return [*self.outputs, *self.input_order]

    def same_body(self, other: ComponentSpec) -> bool:
        """Return whether the two differ at most in name and parameters (docs/semantics.md section 6).

        The order of ports, assumptions and endpoints makes no difference; that of modes does.
        """
        return self._body() == other._body()

    def _body(self) -> tuple[object, ...]:
        return (
            self.inputs,
            self.tolerates,
            self.conditions,
            frozenset(self.outputs),
            {functionality.name: functionality.meaning() for functionality in self},
            self.resource_usage,
            frozenset(self.allows),
            self.run,
            self.package,
            self.container,
            self.prefix,
            self.environment,
            self.gate,
            self.once,
            self.unnamed,
            self.renames,
            self.topics,
            self.lazy,
        )


@dataclass(frozen=True, slots=True)
class Connector:
    """A topic, service or ROS action: one guarantee, and perhaps a cap on its publishers (docs/semantics.md section 2).

    A service or ROS action has at most one server, which counts as its publisher.
    ``name`` is the connector's identity, ``topic`` the name on the wire. They differ only while a topic's contract
    is being changed, when the old and the new connector exist side by side.
    """

    name: str
    guarantee: Predicate
    max_publishers: int | None = None
    topic: str = ""

    def __post_init__(self) -> None:
        if not self.topic:
            object.__setattr__(self, "topic", self.name)
        if self.kind != "topic":  # whatever is stated
            object.__setattr__(self, "max_publishers", 1)

    @property
    def kind(self) -> ConnectorKind:
        return self.guarantee.kind

    def same_contract(self, other: Connector) -> bool:
        """Return whether both are one topic with one contract; a cap is not part of the contract."""
        return self.topic == other.topic and self.guarantee == other.guarantee


@dataclass(frozen=True, slots=True)
class EnvironmentGuarantee:
    """A guarantee of the environment. With a topic, it is a publisher out of scope on that topic alone."""

    name: str
    guarantee: Predicate
    topic: str | None = None


@dataclass(frozen=True, slots=True)
class Resource:
    """Something of limited capacity that components hold: a device file (1), memory (MiB), a processor (percent).

    ``host``: the one that has it; nodes on others cannot hold it.
    """

    name: str
    capacity: float = 1.0
    host: str = OWN_HOST

    @property
    def key(self) -> str:
        """The name by which a specification and its configurations have it: ``gpu``, ``gpu on arm``."""
        return resource_key(self.name, self.host)
