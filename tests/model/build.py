"""Small systems in few words, for the named cases. All messages are of one type; what differs is their rate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from immutables import Map

from midstride.model.component import (
    Assumption,
    ComponentSpec,
    Connector,
    EnvironmentGuarantee,
    FunctionalityRef,
    FunctionalitySpec,
    InputAlternatives,
    Mode,
    ParameterSpec,
    PortRef,
    Resource,
)
from midstride.model.configuration import Configuration, Instance, SystemContext, configure
from midstride.model.contract import Predicate

TYPE = "demo_msgs/msg/Scan"


def at(rate: float | None = None, type_: str = TYPE) -> Predicate:
    return Predicate(type_, rate)


def named(*inputs: str) -> InputAlternatives:
    return InputAlternatives(inputs)


def mode(name: str, assumes: Sequence[Assumption] = (), **guarantees: Predicate) -> Mode:
    return Mode(name, tuple(assumes), Map(guarantees))


def component(
    name: str,
    inputs: Mapping[str, Predicate],
    outputs: Sequence[str],
    modes: Sequence[Mode],
    *,
    resource_usage: Mapping[str, float] | None = None,
    parameters: Mapping[str, ParameterSpec] | None = None,
) -> ComponentSpec:
    """A component of one functionality, `work`, that uses and produces all there is."""
    work = FunctionalitySpec("work", tuple(modes), tuple(inputs), tuple(outputs))
    return ComponentSpec.of(
        name,
        inputs=inputs,
        outputs=tuple(outputs),
        functionalities=(work,),
        resource_usage=resource_usage,
        parameters=parameters,
    )


def source(name: str = "Source", rate: float = 10.0, **options: Mapping[str, float]) -> ComponentSpec:
    """Publishes on `out` whatever happens, and nothing when degraded."""
    return component(
        name,
        {},
        ["out"],
        [mode("normal", out=at(rate)), mode("degraded")],
        resource_usage=options.get("resource_usage"),
    )


def filter_(name: str = "Filter", needs: float = 5.0, gives: float = 10.0) -> ComponentSpec:
    """Publishes on `out` while it receives on `in`."""
    return component(name, {"in": at(needs)}, ["out"], [mode("normal", [named("in")], out=at(gives)), mode("degraded")])


def sink(name: str = "Sink", needs: float = 5.0) -> ComponentSpec:
    return component(name, {"in": at(needs)}, [], [mode("normal", [named("in")]), mode("degraded")])


def system(
    instances: Mapping[str, ComponentSpec],
    attachments: Sequence[str],
    *,
    topics: Mapping[str, Predicate] | None = None,
    caps: Mapping[str, int] | None = None,
    environment: Sequence[EnvironmentGuarantee] = (),
    resources: Mapping[str, float] | None = None,
    modes: Mapping[str, int] | None = None,
) -> Configuration:
    """``attachments`` as "node.port /topic"; topics not told guarantee 5 Hz; modes not told are the last."""
    pairs = [(PortRef.parse(port), topic) for port, topic in (text.split() for text in attachments)]
    names = {topic: at(5.0) for _, topic in pairs} | dict(topics or {})
    world = SystemContext(
        Map({name: Connector(name, guarantee, (caps or {}).get(name)) for name, guarantee in names.items()}),
        tuple(environment),
        Map({name: Resource(name, capacity) for name, capacity in (resources or {}).items()}),
    )
    live = [Instance(name, name, kind) for name, kind in instances.items()]
    chosen = {FunctionalityRef.parse(ref): index for ref, index in (modes or {}).items()}
    return configure(world, live, pairs, chosen)


def modes_of(configuration: Configuration) -> dict[str, str]:
    """Each instance's mode, by name, for components of one functionality."""
    return {ref.instance: configuration.mode(ref).name for ref in configuration.modes}


def work(name: str) -> FunctionalityRef:
    return FunctionalityRef(name, "work")


def port(text: str) -> PortRef:
    return PortRef.parse(text)
