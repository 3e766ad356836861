"""A configuration: what runs, which port is attached to which topic, and which mode each functionality is in.

A snapshot of a system, as a value: it is never mutated, and every change yields a new one that shares what did not
change (``immutables.Map``), so the cost of a change does not depend on the size of the system. Whether a
configuration is valid is not decided here but in :mod:`midstride.model.rules` (docs/semantics.md section 2).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import lru_cache
from typing import TypeVar

from immutables import Map

from midstride.model.component import (
    ComponentSpec,
    Connector,
    EnvironmentGuarantee,
    FunctionalityRef,
    FunctionalitySpec,
    Mode,
    ParameterSection,
    ParameterValue,
    PortRef,
    Resource,
    SharedContainer,
)
from midstride.model.contract import Contract, Predicate
from midstride.model.hosts import OWN_HOST, resource_key

K = TypeVar("K")
V = TypeVar("V")
PortSet = Map[PortRef, None]
NameSet = Map[str, None]
_NO_PORTS: PortSet = Map()
_NO_NAMES: NameSet = Map()
_NONE_HELD = Fraction()


@dataclass(frozen=True, slots=True)
class SystemContext:
    """The surroundings of the components: the connectors, the environment, the resources."""

    connectors: Map[str, Connector] = field(default_factory=Map)
    environment: tuple[EnvironmentGuarantee, ...] = ()
    resources: Map[str, Resource] = field(default_factory=Map)
    _by_topic: dict[str | None, tuple[EnvironmentGuarantee, ...]] = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        by_topic: dict[str | None, tuple[EnvironmentGuarantee, ...]] = {}
        for offer in self.environment:
            by_topic[offer.topic] = (*by_topic.get(offer.topic, ()), offer)
        object.__setattr__(self, "_by_topic", by_topic)

    def publishers_out_of_scope(self, connector: Connector) -> tuple[EnvironmentGuarantee, ...]:
        """The environment's guarantees on the connector's topic."""
        return self._by_topic.get(connector.topic, ())

    def offers(self) -> tuple[EnvironmentGuarantee, ...]:
        """The environment's guarantees that hold without any attachment."""
        return self._by_topic.get(None, ())

    def capacity(self, resource: str) -> float:
        """The capacity of ``resource``; 1 for one that is not declared."""
        declared = self.resources.get(resource)
        return 1.0 if declared is None else declared.capacity


@lru_cache(maxsize=4096)
def to_fraction(amount: float) -> Fraction:
    """The number exactly as written, so that 0.1 + 0.2 is 0.3 and a sum does not depend on its order."""
    return Fraction(repr(amount))


@dataclass(frozen=True, slots=True)
class Instance:
    """A running instance of a role's component. The first one has the role's name (docs/semantics.md section 6).

    ``parameters`` holds the value of every parameter: its component's where none is given. ``sections``: parameters of
    further nodes in its process. ``container``: the one of the system that loads it, where it shares one; ``process``
    is then the name of the process of a container that it is in with others, and empty where it has one for itself, as
    a replacement has that has left the others. ``host``: the one that it runs on.
    """

    name: str
    role: str
    component: ComponentSpec
    parameters: Map[str, ParameterValue] = field(default_factory=Map)
    sections: tuple[ParameterSection, ...] = ()
    container: SharedContainer | None = None
    process: str = ""
    host: str = OWN_HOST

    def __post_init__(self) -> None:
        declared = self.component.parameters
        missing = {name: declared[name].value for name in declared if name not in self.parameters}
        if missing:
            object.__setattr__(self, "parameters", self.parameters.update(missing))

    @property
    def started(self) -> ComponentSpec:
        """The component with how its process is started and ended: a container that it shares states that for it.

        The start of the container and that of the node both count, as the first node of a process waits for it.
        """
        if self.container is None:
            return self.component
        program, own = self.container.program, self.component
        times = [each for each in (program.startup_seconds, own.startup_seconds) if each is not None]
        stop = own.stop
        if program.stop is not None:
            stop = replace(own.stop_times, sigterm=program.stop.sigterm, sigkill=program.stop.sigkill)
        return replace(
            own,
            container=None if own.container is None else program,
            prefix=program.prefix,
            environment=program.environment,
            startup_seconds=sum(times) if times else None,
            stop=stop,
        )

    @property
    def resource_usage(self) -> Map[str, float]:
        """The amount that it holds of each resource of its host, by the key of the resource."""
        usage = self.component.resource_usage
        return Map({resource_key(name, self.host): usage[name] for name in usage}) if self.host else usage

    def functionality_refs(self) -> list[FunctionalityRef]:
        return [FunctionalityRef(self.name, name) for name in self.component.functionality_order]


@dataclass(frozen=True, slots=True)
class Configuration:
    """The live components, the attachments, and the current mode of each functionality.

    ``connectors_of`` maps an attached port to its connectors; ``publishers`` and ``subscribers`` are the same
    relation seen from a connector; ``held`` is how much of each resource the live components hold together,
    ``holders`` which of them do; ``instances_by_role`` names the live instances of each role. The last five are
    derived, kept so that a change does not walk the system. Empty entries are dropped, so that configurations
    reached in different ways are equal values.
    """

    context: SystemContext = field(default_factory=SystemContext)
    instances: Map[str, Instance] = field(default_factory=Map)
    connectors_of: Map[PortRef, NameSet] = field(default_factory=Map)
    modes: Map[FunctionalityRef, int] = field(default_factory=Map)
    publishers: Map[str, PortSet] = field(default_factory=Map)
    subscribers: Map[str, PortSet] = field(default_factory=Map)
    held: Map[str, Fraction] = field(default_factory=Map)
    holders: Map[str, NameSet] = field(default_factory=Map)
    instances_by_role: Map[str, NameSet] = field(default_factory=Map)

    # -- reading ---------------------------------------------------------------------------------

    def component(self, instance: str) -> ComponentSpec:
        """The component of ``instance``. Raises KeyError where it is not live."""
        return self.instances[instance].component

    def functionality(self, ref: FunctionalityRef) -> FunctionalitySpec:
        return self.component(ref.instance).functionalities[ref.functionality]

    def find_functionality(self, ref: FunctionalityRef) -> FunctionalitySpec | None:
        """The functionality ``ref``, or None where no such functionality is live."""
        instance = self.instances.get(ref.instance)
        return None if instance is None else instance.component.functionalities.get(ref.functionality)

    def mode(self, ref: FunctionalityRef) -> Mode:
        """The current mode of a live functionality."""
        return self.functionality(ref).modes[self.modes[ref]]

    def is_output(self, port: PortRef) -> bool:
        return self.component(port.instance).has_output(port.port)

    def has_port(self, port: PortRef) -> bool:
        """Return whether ``port`` is a port of a live component."""
        instance = self.instances.get(port.instance)
        if instance is None:
            return False
        return port.port in instance.component.inputs or instance.component.has_output(port.port)

    def attached_to(self, port: PortRef) -> list[str]:
        """The connectors ``port`` is attached to, sorted."""
        return sorted(self.connectors_of.get(port, _NO_NAMES))

    def is_attached(self, port: PortRef, connector: str) -> bool:
        return connector in self.connectors_of.get(port, _NO_NAMES)

    def publishers_on(self, connector: str) -> PortSet:
        return self.publishers.get(connector, _NO_PORTS)

    def subscribers_on(self, connector: str) -> PortSet:
        return self.subscribers.get(connector, _NO_PORTS)

    def attachments(self) -> Iterator[tuple[PortRef, str]]:
        """Every attachment, in no particular order."""
        for port, connectors in self.connectors_of.items():
            for connector in connectors:
                yield port, connector

    def attached_ports(self, instance: str) -> list[tuple[PortRef, str]]:
        """The attachments of one instance, outputs first, in order of declaration."""
        ports = (PortRef(instance, port) for port in self.component(instance).ports())
        return [(port, connector) for port in ports for connector in self.attached_to(port)]

    def guarantee(self, output: PortRef) -> Contract:
        """The guarantee of a live output in the current mode of its owner."""
        owner = self.component(output.instance).owner(output.port)
        return owner.modes[self.modes[FunctionalityRef(output.instance, owner.name)]].guarantee(output.port)

    def rate(self, output: PortRef) -> float | None:
        """The rate (Hz) that a live output guarantees now, if any."""
        guarantee = self.guarantee(output)
        return guarantee.rate if isinstance(guarantee, Predicate) else None

    def bound(self, output: PortRef) -> float | None:
        """The bound (s) within which a live server guarantees to respond now, if any."""
        guarantee = self.guarantee(output)
        return guarantee.within if isinstance(guarantee, Predicate) else None

    def topic(self, connector: str) -> str:
        return self.context.connectors[connector].topic

    def is_topic(self, connector: str) -> bool:
        """Return whether it is a topic; else it is a service or a ROS action."""
        return self.context.connectors[connector].kind == "topic"

    def users(self, input_port: PortRef) -> list[FunctionalityRef]:
        """The functionalities associated with a live input."""
        component = self.component(input_port.instance)
        return [FunctionalityRef(input_port.instance, f.name) for f in component.users(input_port.port)]

    def consumers(self, connector: str) -> Iterator[FunctionalityRef]:
        """The functionalities that use an input attached to ``connector``; one may occur several times."""
        for port in self.subscribers_on(connector):
            yield from self.users(port)

    def published(self, ref: FunctionalityRef) -> Iterator[tuple[str, str]]:
        """Each output of a live functionality, with each connector that it is attached to."""
        for output in self.functionality(ref).outputs:
            for connector in self.connectors_of.get(PortRef(ref.instance, output), ()):
                yield output, connector

    def downstream(self, ref: FunctionalityRef) -> Iterator[FunctionalityRef]:
        """The functionalities that use what ``ref`` publishes; one may occur several times."""
        for _, connector in self.published(ref):
            yield from self.consumers(connector)

    def instances_of(self, role: str) -> list[Instance]:
        """The live instances of a role, sorted by name."""
        return [self.instances[name] for name in sorted(self.instances_by_role.get(role, _NO_NAMES))]

    # -- changing: each yields a new configuration, valid or not ------------------------------------

    def with_instance(self, instance: Instance) -> Configuration:
        """``instance`` live and isolated, every functionality in its last mode, in place of one that has its name."""
        if instance.name in self.instances:
            return self.without_instance(instance.name).with_instance(instance)
        held, holders = self.held, self.holders
        for resource, amount in instance.resource_usage.items():
            held = held.set(resource, held.get(resource, _NONE_HELD) + to_fraction(amount))
            holders = _added(holders, resource, instance.name)
        return replace(
            self,
            instances=self.instances.set(instance.name, instance),
            modes=self.modes.update({FunctionalityRef(instance.name, f.name): f.last_mode for f in instance.component}),
            held=held,
            holders=holders,
            instances_by_role=_added(self.instances_by_role, instance.role, instance.name),
        )

    def without_instance(self, name: str) -> Configuration:
        """``name`` no longer live, nor any of its attachments."""
        instance = self.instances[name]
        isolated = self
        for port, connector in self.attached_ports(name):
            isolated = isolated.without_attachment(port, connector)
        held, holders = isolated.held, isolated.holders
        for resource, amount in instance.resource_usage.items():
            holders = _dropped(holders, resource, name)
            rest = held[resource] - to_fraction(amount)
            held = held.set(resource, rest) if resource in holders else held.delete(resource)
        modes = isolated.modes
        for ref in instance.functionality_refs():
            modes = modes.delete(ref)
        return replace(
            isolated,
            instances=isolated.instances.delete(name),
            modes=modes,
            held=held,
            holders=holders,
            instances_by_role=_dropped(isolated.instances_by_role, instance.role, name),
        )

    def with_attachment(self, port: PortRef, connector: str) -> Configuration:
        connectors_of = _added(self.connectors_of, port, connector)
        if self.is_output(port):
            return replace(self, connectors_of=connectors_of, publishers=_added(self.publishers, connector, port))
        return replace(self, connectors_of=connectors_of, subscribers=_added(self.subscribers, connector, port))

    def without_attachment(self, port: PortRef, connector: str) -> Configuration:
        connectors_of = _dropped(self.connectors_of, port, connector)
        if self.is_output(port):
            return replace(self, connectors_of=connectors_of, publishers=_dropped(self.publishers, connector, port))
        return replace(self, connectors_of=connectors_of, subscribers=_dropped(self.subscribers, connector, port))

    def with_modes(self, modes: Mapping[FunctionalityRef, int]) -> Configuration:
        return replace(self, modes=self.modes.update(modes)) if modes else self

    def with_parameters(self, name: str, parameters: Mapping[str, ParameterValue]) -> Configuration:
        instance = self.instances[name]
        changed = replace(instance, parameters=instance.parameters.update(parameters))
        return replace(self, instances=self.instances.set(name, changed))

    def with_context(self, context: SystemContext) -> Configuration:
        return replace(self, context=context)


def _added(index: Map[K, Map[V, None]], key: K, member: V) -> Map[K, Map[V, None]]:
    """``index`` with ``member`` in the set under ``key``."""
    members: Map[V, None] = index.get(key, Map())
    return index.set(key, members.set(member, None))


def _dropped(index: Map[K, Map[V, None]], key: K, member: V) -> Map[K, Map[V, None]]:
    """``index`` without it; an empty set is dropped."""
    rest = index[key].delete(member)
    return index.set(key, rest) if rest else index.delete(key)


def configure(
    context: SystemContext,
    instances: Iterable[Instance],
    attachments: Iterable[tuple[PortRef, str]],
    modes: Mapping[FunctionalityRef, int] | None = None,
) -> Configuration:
    """A whole configuration; functionalities not in ``modes`` are in their last mode."""
    configuration = Configuration(context)
    for instance in instances:
        configuration = configuration.with_instance(instance)
    for port, connector in attachments:
        configuration = configuration.with_attachment(port, connector)
    return configuration.with_modes(modes or {})
