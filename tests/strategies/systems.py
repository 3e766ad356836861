"""Hypothesis strategies over the model: contracts, components, specifications, configurations.

Everything is drawn from few types, rates and topics, so that contracts often match. The results are well formed (M1
to M3; every output is owned) and every attachment fits, as ``attach`` requires. They include cycles, topics with
several publishers, inputs on several topics, services and ROS actions with one of several possible servers, caps,
resources, the environment and both forms of assumption.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise, product
from typing import Final

from hypothesis import strategies as st
from immutables import Map

from midstride.model.best import lowered
from midstride.model.component import (
    Assumption,
    ComponentSpec,
    Connector,
    EnvironmentGuarantee,
    FunctionalityRef,
    FunctionalitySpec,
    InputAlternatives,
    Mode,
    NodeEndpoint,
    ParameterSpec,
    Resource,
)
from midstride.model.configuration import Configuration, SystemContext
from midstride.model.contract import (
    NOTHING,
    ConnectorKind,
    Contract,
    Durability,
    Interval,
    Liveliness,
    OneOf,
    Predicate,
    QoS,
    Reliability,
    Scalar,
    ValueSet,
    satisfies,
)
from midstride.model.rules import normal_guarantee
from midstride.model.specification import Constraint, Keep, Limit, Node, Order, Specification, structure
from tests.kinds import KINDS, of_kind

TYPES: Final = ("demo_msgs/msg/A", "demo_msgs/msg/B")
RATES: Final = (None, 1.0, 5.0, 10.0)
BOUNDS: Final = (None, 1.0, 0.2, 0.1)
SERVED_TYPES: Final = ("demo_msgs/srv/A", "demo_msgs/action/A")
RESOURCES: Final = ("gpu", "/dev/video0")
TOPICS: Final = ("/t0", "/t1", "/t2", "/t3", "/t4")

_A, _B = TYPES
_LOSSY: Final = QoS(reliability="best_effort")
_WIDE: Final = (("width", Interval(low=1)),)
# The contracts of ports and topics: few enough to match often, different in every clause. Services and ROS actions have
# those that ``of_kind`` makes of them.
NEEDS: Final = (Predicate(_A, 5.0), Predicate(_A, 1.0), Predicate(_A), Predicate(_A, 1.0, _LOSSY), Predicate(_B, 1.0))
_USUAL: Final = (*NEEDS[:2] * 3, *NEEDS)
OFFERS: Final = (
    Predicate(_A, 10.0),
    Predicate(_A, 5.0, fields=_WIDE),
    Predicate(_A, 1.0),
    Predicate(_A, 5.0, _LOSSY),
    Predicate(_B, 5.0),
)


# -- contracts ---------------------------------------------------------------------------------------


@cache
def intervals() -> st.SearchStrategy[Interval]:
    """Intervals with ends among a few whole numbers, some of them open, some empty."""
    lows = st.sampled_from((float("-inf"), 0, 1, 2))
    highs = st.sampled_from((float("inf"), 3, 2, 1))
    return st.builds(Interval, lows, highs, st.booleans(), st.booleans())


@cache
def value_sets() -> st.SearchStrategy[ValueSet]:
    """Sets of values that are not empty."""
    members: tuple[Scalar, ...] = (0, 1, 2, 2.5, True, "rgb8", "bgr8")
    some = st.lists(st.sampled_from(members), min_size=1, max_size=3).map(OneOf.of)
    return st.one_of(intervals().filter(lambda interval: not interval.is_empty), some)


_RELIABILITIES: Final[tuple[Reliability | None, ...]] = (None, "reliable", "best_effort")
_DURABILITIES: Final[tuple[Durability | None, ...]] = (None, "volatile", "transient_local")
_LIVELINESSES: Final[tuple[Liveliness | None, ...]] = (None, "automatic", "manual_by_topic")
_UNCOMPARED: Final = (QoS(), QoS(depth=1, history="keep_last"), QoS(depth=10, history="keep_all", lifespan=3.0))
_PROFILES: Final = [
    replace(rest, reliability=reliability, durability=durability, deadline=deadline, liveliness=liveliness, lease=lease)
    for rest in _UNCOMPARED
    for reliability, durability, deadline, liveliness, lease in product(
        _RELIABILITIES, _DURABILITIES, (None, 0.5, 1.0), _LIVELINESSES, (None, 2.0)
    )
]


@cache
def qos_profiles() -> st.SearchStrategy[QoS]:
    return st.sampled_from(_PROFILES)


@cache
def predicates() -> st.SearchStrategy[Predicate]:
    """Predicates that differ in everything there is."""
    one = st.tuples(st.sampled_from(("width", "header.frame_id")), value_sets()).map(lambda field: (field,))
    two = st.tuples(value_sets(), value_sets()).map(lambda sets: (("width", sets[0]), ("height", sets[1])))
    messages = st.builds(
        Predicate, st.sampled_from(TYPES), st.sampled_from(RATES), qos_profiles(), st.one_of(st.just(()), one, two)
    )
    requests = st.builds(Predicate, st.sampled_from(SERVED_TYPES), within=st.sampled_from(BOUNDS))
    return st.one_of(messages, messages, requests)


@cache
def contracts() -> st.SearchStrategy[Contract]:
    return st.one_of(st.just(NOTHING), predicates())


@st.composite
def stronger(draw: st.DrawFn, weaker: Predicate) -> Predicate:
    """A predicate of the same endpoint that satisfies ``weaker``."""
    if weaker.kind != "topic":
        bounds = [bound for bound in BOUNDS if weaker.within is None or (bound is not None and bound <= weaker.within)]
        return replace(weaker, within=draw(st.sampled_from(bounds)))
    rates = [rate for rate in RATES if weaker.rate is None or (rate is not None and rate >= weaker.rate)]
    fields = dict(weaker.fields)
    for path, values in weaker.fields:
        narrowed = values.intersection(draw(value_sets()))
        if not narrowed.is_empty:
            fields[path] = narrowed
    if draw(st.booleans()):
        fields.setdefault("height", Interval(low=1))
    return replace(weaker, rate=draw(st.sampled_from(rates)), fields=tuple(fields.items()))


def _chains(length: int) -> list[tuple[Contract, ...]]:
    """All that one output may guarantee in a chain of modes, best first, made of OFFERS: M2 and M3 hold."""

    def allowed(chain: tuple[Contract, ...]) -> bool:
        stated = [contract for contract in chain if isinstance(contract, Predicate)]
        one_endpoint = all(c.type == stated[0].type and c.qos == stated[0].qos for c in stated)
        return one_endpoint and all(worse is NOTHING or satisfies(better, worse) for better, worse in pairwise(chain))

    links: tuple[Contract, ...] = (*OFFERS, NOTHING)
    return [chain for chain in product(links, repeat=length) if allowed(chain)]


_CHAINS: Final = {length: _chains(length) for length in (2, 3)}
# Mostly a strong guarantee that the last mode loses, so that one functionality's fall is felt by another.
_LOSING: Final = {
    length: [chain for chain in chains if chain[0] == OFFERS[0] and chain[-1] is NOTHING]
    for length, chains in _CHAINS.items()
}


def guarantee_chains(length: int, kind: ConnectorKind = "topic") -> st.SearchStrategy[tuple[Contract, ...]]:
    """What one output guarantees in each mode, best first; mostly nothing in the last."""
    often = _LOSING[length] * (2 * len(_CHAINS[length]) // len(_LOSING[length]))
    return st.sampled_from(often + _CHAINS[length]).map(
        lambda chain: tuple(of_kind(each, kind) if isinstance(each, Predicate) else each for each in chain)
    )


# -- components --------------------------------------------------------------------------------------


@st.composite
def components(draw: st.DrawFn, name: str = "C", kinds: tuple[ConnectorKind, ...] = KINDS) -> ComponentSpec:
    """Well-formed components of up to three inputs, two outputs and two functionalities; filters for the most part.

    Their ports are for connectors of these ``kinds``.
    """
    count = draw(st.sampled_from((1, 1, 2, 0, 3)))
    inputs = {f"in{number}": draw(_needs(kinds)) for number in range(count)}
    owners = draw(st.sampled_from(((0,), (0,), (0, 0), (0, 1), (1,), ())))  # which functionality owns each output
    owned: dict[int, list[str]] = {0: [], 1: []}
    for number, owner in enumerate(owners):
        owned[owner].append(f"out{number}")
    count = 1 + max((*owners, draw(st.sampled_from((0, 0, 1)))))
    return ComponentSpec.of(
        name,
        inputs=inputs,
        outputs=tuple(f"out{number}" for number in range(len(owners))),
        functionalities=tuple(draw(_functionalities(f"f{n}", inputs, tuple(owned[n]), kinds)) for n in range(count)),
        resource_usage=draw(st.sampled_from(({}, {}, {"gpu": 0.1}, {"gpu": 0.2, "/dev/video0": 1.0}))),
        parameters=draw(st.sampled_from(({}, _PARAMETERS))),
        tolerates={port: 3 for port in draw(st.sampled_from(((), ("in0",)))) if port in inputs and inputs[port].rate},
    )


_PARAMETERS: Final = {"gain": ParameterSpec(0.5, changeable=True), "model": ParameterSpec("small")}


def _needs(kinds: tuple[ConnectorKind, ...]) -> st.SearchStrategy[Predicate]:
    return st.builds(of_kind, st.sampled_from(_USUAL), st.sampled_from(kinds))


@st.composite
def _functionalities(
    draw: st.DrawFn, name: str, inputs: dict[str, Predicate], outputs: tuple[str, ...], kinds: tuple[ConnectorKind, ...]
) -> FunctionalitySpec:
    spared = draw(st.sampled_from((None, None, None, *inputs)))
    used = tuple(port for port in inputs if port != spared)
    length = draw(st.sampled_from((2, 2, 3)))
    chains = {output: draw(guarantee_chains(length, draw(st.sampled_from(kinds)))) for output in outputs}
    modes = []
    for index in range(length):
        assumed = draw(_assumptions(inputs, used)) if index < length - 1 else ()
        guaranteed = {output: chain[index] for output, chain in chains.items()}
        stated = {output: contract for output, contract in guaranteed.items() if isinstance(contract, Predicate)}
        modes.append(Mode(f"m{index}", assumed, Map(stated)))
    weight = draw(st.sampled_from((1.0, 3.0, 0.5)))
    return FunctionalitySpec(name, tuple(modes), used, outputs, weight)


def _assumptions(inputs: dict[str, Predicate], used: tuple[str, ...]) -> st.SearchStrategy[tuple[Assumption, ...]]:
    """None, one or several: of one input, of alternatives, or by a predicate."""
    if not used:
        return st.sampled_from(((), (), (), (NEEDS[1],)))
    each: list[tuple[Assumption, ...]] = [(InputAlternatives((port,)),) for port in used]
    predicate: list[tuple[Assumption, ...]] = [(inputs[port],) for port in used[:1]]
    several: list[tuple[Assumption, ...]] = [
        (),
        (InputAlternatives(used),),
        tuple(InputAlternatives((p,)) for p in used),
        (NEEDS[2],),
    ]
    return st.sampled_from([*each * 3, *predicate * 2, *several])


# -- systems -----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class GeneratedSystem:
    """A valid configuration, and the components that actions on it may create."""

    configuration: Configuration
    components: tuple[ComponentSpec, ...]


@st.composite
def specifications(draw: st.DrawFn, *, most: int = 6) -> Specification:
    """Well-formed specifications of up to ``most`` nodes, whose attachments fit and whose caps and capacities hold.

    In some, components are drawn independently of each other. The others are networks, often with cycles, in which
    each functionality depends on the ones before it.
    """
    bare = draw(st.one_of(_networks(most), _networks(most), _independent(most)))
    configuration = structure(bare)
    connectors = dict(bare.connectors)
    capped = draw(st.sampled_from((None, *sorted(connectors))))
    if capped is not None:
        count = len(configuration.publishers_on(capped)) + len(
            configuration.context.publishers_out_of_scope(connectors[capped])
        )
        connectors[capped] = replace(connectors[capped], max_publishers=count + draw(st.integers(0, 1)))
    spare = draw(st.sampled_from((0.0, 0.3, 2.0)))
    resources = {name: Resource(name, float(configuration.held.get(name, 0)) + spare or 1.0) for name in RESOURCES}
    whole = replace(bare, connectors=Map(connectors), resources=Map(resources))
    timing = draw(st.sampled_from(({}, {"create": 0.25, "handover": 0.0}, {"probation": 1.0, "watch_after": 2.5})))
    return replace(whole, constraints=draw(_constraints(whole)), timing=Map(timing))


def _specification(
    cast: dict[str, ComponentSpec],
    wiring: dict[str, dict[str, tuple[str, ...]]],
    topics: dict[str, Predicate],
    environment: tuple[EnvironmentGuarantee, ...],
) -> Specification:
    nodes = {}
    for role, component in cast.items():
        own = Map({"gain": 0.75}) if "gain" in component.parameters and role[-1] in "13" else Map()
        nodes[role] = Node(role, component.name, Map(wiring[role]), own)
    return Specification(
        "drawn",
        connectors=Map({name: Connector(name, guarantee) for name, guarantee in topics.items()}),
        components=Map({component.name: component for component in cast.values()}),
        nodes=Map(nodes),
        environment=environment,
    )


@st.composite
def _independent(draw: st.DrawFn, most: int) -> Specification:
    # One kind or two, so that contracts often match.
    kinds = draw(st.sampled_from(_KINDS_OF_A_SYSTEM))
    types = [draw(components(f"C{number}", kinds)) for number in range(draw(st.sampled_from((3, 2, 1))))]
    names = TOPICS[: draw(st.sampled_from((4, 3, 2, 1)))]
    topics = {name: draw(_needs(kinds)) for name in names}
    environment = draw(_environments(topics))
    count = draw(st.sampled_from((*range(most, 1, -1), 1)))
    cast = {f"n{number}": draw(st.sampled_from(types)) for number in range(count)}
    return _specification(cast, draw(_wiring(cast, topics, environment)), topics, environment)


_KINDS_OF_A_SYSTEM: Final[tuple[tuple[ConnectorKind, ...], ...]] = (
    ("topic",),
    ("service",),
    ("topic", "service"),
    ("topic", "action"),
    ("service", "action"),
)


@st.composite
def _environments(draw: st.DrawFn, topics: dict[str, Predicate]) -> tuple[EnvironmentGuarantee, ...]:
    """What is offered outside; of the servers of one service there, at most one."""
    offers: list[EnvironmentGuarantee] = []
    for number in range(draw(st.sampled_from((0, 0, 1, 2)))):
        served = {offer.topic for offer in offers if offer.guarantee.kind != "topic"}
        topic = draw(st.sampled_from((None, *(name for name in topics if name not in served))))
        kind = draw(st.sampled_from(KINDS)) if topic is None else topics[topic].kind
        offers.append(EnvironmentGuarantee(f"e{number}", of_kind(draw(st.sampled_from(OFFERS)), kind), topic))
    return tuple(offers)


@st.composite
def _networks(draw: st.DrawFn, most: int) -> Specification:
    """Each node publishes a topic of its own, now and then another's as well, and reads up to two of the others'.

    In place of the topic it may have a service or a ROS action, which has one server.
    """
    count = draw(st.sampled_from((*range(most, 1, -1), 1)))
    names = tuple(f"/t{number}" for number in range(count))
    kinds = draw(st.sampled_from((*_KINDS_OF_A_SYSTEM, KINDS)))
    topics = {name: of_kind(draw(st.sampled_from(NEEDS[:3])), draw(st.sampled_from(kinds))) for name in names}
    environment = draw(_environments(topics))
    outside = {offer.topic for offer in environment}
    cast, wiring = {}, {}
    for number, own in enumerate(names):
        near = names[max(0, number - 2) : number] * count  # those before, and at times any: so there are cycles
        read = [
            draw(st.sampled_from((*near, *names))) for _ in range(draw(st.sampled_from((1, 1, 2, 0))) if number else 0)
        ]
        inputs = {f"in{index}": topics[name] for index, name in enumerate(read)}
        cast[f"n{number}"] = ComponentSpec.of(
            f"C{number}", inputs=inputs, outputs=("out0",), functionalities=(draw(_links(inputs, topics[own].kind)),)
        )
        also = draw(st.sampled_from((*[own] * count, *(name for name in names if topics[name].kind == "topic"))))
        written = (
            dict.fromkeys((own, also)) if topics[own].kind == "topic" else {own: None} if own not in outside else {}
        )
        wiring[f"n{number}"] = {"out0": tuple(written)} if written else {}
        wiring[f"n{number}"] |= {f"in{index}": (name,) for index, name in enumerate(read)}
    return _specification(cast, wiring, topics, environment)


@st.composite
def _links(draw: st.DrawFn, inputs: dict[str, Predicate], kind: ConnectorKind) -> FunctionalitySpec:
    """A functionality that passes on what it receives; a source has what it needs, or lacks it."""
    best, less_good = (of_kind(offer, kind) for offer in OFFERS[:3:2])
    used = tuple(inputs)
    forms: list[tuple[Assumption, ...]] = [(), (NEEDS[4],)]
    if used:
        each = tuple(InputAlternatives((port,)) for port in used)
        forms = [each, each, each, (InputAlternatives(used),), (inputs[used[0]],)]
    normal = draw(st.sampled_from(forms))
    middle: list[tuple[tuple[Assumption, ...], Map[str, Predicate]]] = []
    if draw(st.booleans()):
        less = draw(st.sampled_from((normal[:1], normal[1:])))
        middle.append((less, Map({"out0": draw(st.sampled_from((best, less_good)))})))
    chain = [(normal, Map({"out0": best})), *middle, ((), Map())]
    modes = tuple(Mode(f"m{index}", assumed, stated) for index, (assumed, stated) in enumerate(chain))
    return FunctionalitySpec("f0", modes, used, ("out0",))


@st.composite
def _wiring(
    draw: st.DrawFn,
    cast: dict[str, ComponentSpec],
    topics: dict[str, Predicate],
    environment: tuple[EnvironmentGuarantee, ...],
) -> dict[str, dict[str, tuple[str, ...]]]:
    """The topics of each port of each node: one for the most part. A topic mostly has one publisher, an input some."""
    wiring: dict[str, dict[str, tuple[str, ...]]] = {role: {} for role in cast}
    published: list[str] = []
    outside = {offer.topic for offer in environment}
    for role, component in cast.items():
        for port in component.outputs:
            served = {name for name in topics if topics[name].kind != "topic" and name in {*published, *outside}}
            offered = normal_guarantee(component, port)
            fit = [name for name in topics if name not in served and satisfies(offered, topics[name])]
            better = [name for name in fit if name not in published]
            if chosen := draw(_some(fit, better)):
                wiring[role][port] = chosen
                published += chosen
    for role, component in cast.items():
        for port in component.input_order:
            fit = [name for name in topics if satisfies(topics[name], component.inputs[port])]
            if chosen := draw(_some(fit, [name for name in fit if name in published])):
                wiring[role][port] = chosen
    return wiring


def _some(fit: list[str], better: list[str]) -> st.SearchStrategy[tuple[str, ...]]:
    if not fit:
        return st.just(())
    return st.sampled_from([*((name,) for name in better * 5 + fit), tuple(fit[:2]), ()])


@st.composite
def _constraints(draw: st.DrawFn, specification: Specification) -> tuple[Constraint, ...]:
    roles = specification.roles()
    found: list[Constraint] = []
    for _ in range(draw(st.sampled_from((0, 0, 1, 2)))):
        role = draw(st.sampled_from(roles))
        functionality = draw(st.sampled_from(list(specification.component_of(role))))
        ref = FunctionalityRef(role, functionality.name)
        later = [other for other in roles if other > role]
        kind = draw(st.sampled_from(("keep", "limit", "order")))
        if kind == "keep":
            found.append(Keep(ref, draw(st.sampled_from(functionality.modes)).name))
        elif kind == "limit":
            found.append(Limit(ref, draw(st.sampled_from((0.0, 1.5)))))
        elif later:
            found.append(Order(role, draw(st.sampled_from(later))))
    return tuple(found)


@st.composite
def configurations(draw: st.DrawFn, *, most: int = 6) -> Configuration:
    """Valid configurations, in any of their valid mode assignments."""
    return draw(scenes(most=most)).configuration


@st.composite
def scenes(draw: st.DrawFn, *, most: int = 6) -> GeneratedSystem:
    specification = draw(specifications(most=most))
    configuration = structure(specification)
    # Any valid assignment is the best one below itself: so all of them are drawn, the best one more often.
    highest = {
        ref: draw(st.sampled_from((0, 0, *range(configuration.functionality(ref).last_mode + 1))))
        for ref in sorted(configuration.modes)
    }
    configuration = configuration.with_modes(highest)
    components_ = tuple(component for _, component in sorted(specification.components.items()))
    return GeneratedSystem(configuration.with_modes(lowered(configuration, sorted(configuration.modes))), components_)


@cache
def endpoints() -> st.SearchStrategy[NodeEndpoint]:
    return st.builds(NodeEndpoint, st.sampled_from(("topic", "service", "action")), st.sampled_from(("~/reset", "/tf")))


def worlds() -> st.SearchStrategy[SystemContext]:
    return specifications().map(lambda specification: specification.context)
