"""Random systems and random changes to them, small and full of what makes planning hard.

Everything follows from the seed of the ``Random`` given, so that a failure is found again. Systems are drawn with
topics alone; :func:`with_services` makes services and ROS actions of some, each of which has at most one server.
"""

from __future__ import annotations

from dataclasses import replace
from random import Random

from immutables import Map

from midstride.model.best import best, lowered
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
    Resource,
)
from midstride.model.configuration import Configuration
from midstride.model.contract import ConnectorKind, Interval, OneOf, Predicate, QoS, ValueSet, satisfies
from midstride.model.specification import Keep, Limit, Node, Order, Specification, initial
from tests.kinds import of_kind, rate_of, with_rate

TYPES = ("std_msgs/msg/A", "std_msgs/msg/B")
PROFILES = (QoS(), QoS(reliability="best_effort"), QoS(durability="transient_local"), QoS(deadline=0.5))
FIELDS: tuple[tuple[tuple[str, ValueSet], ...], ...] = (
    (),
    (("width", Interval(low=1)),),
    (("width", OneOf.of([3.0])),),
    (("encoding", OneOf.of(["mono8", "rgb8"])), ("width", Interval(1, 5))),
)


def strong(rng: Random, kind: str | None = None) -> Predicate:
    """What is promised at best: a rate, now and then a QoS and fields."""
    profile = rng.choice(PROFILES) if rng.random() < 0.2 else PROFILES[0]
    fields = rng.choice(FIELDS) if rng.random() < 0.25 else ()
    plain = with_rate(Predicate(kind or rng.choice(TYPES)), 10.0)
    return replace(plain, qos=profile, fields=fields) if plain.kind == "topic" else plain


def weakened(rng: Random, predicate: Predicate, *, endpoint: bool = False) -> Predicate:
    """The same or less, in any clause; of one ``endpoint`` type and QoS stay (rule M3)."""
    for _ in range(rng.choice((0, 1, 1, 2, 3))):
        clause = rng.randrange(3)
        if clause == 0:
            predicate = with_rate(predicate, rng.choice((5.0, None)) if rate_of(predicate) == 10.0 else None)
        elif clause == 1:
            predicate = replace(predicate, fields=predicate.fields[1:])
        elif not endpoint and predicate.kind == "topic":
            predicate = replace(predicate, qos=rng.choice(PROFILES[:2]))
    return predicate


def predicate(rng: Random, kind: str | None = None) -> Predicate:
    return weakened(rng, strong(rng, kind))


def component(rng: Random, name: str, like: ComponentSpec | None = None) -> ComponentSpec:
    """A component; ``like`` gives the ports, so that the one can take the other's place."""
    if like is None:
        inputs = {f"i{n}": weakened(rng, predicate(rng)) for n in range(rng.choice((0, 1, 1, 2, 3)))}
        outputs = tuple(f"o{n}" for n in range(rng.choice((0, 1, 1, 2))))
        kinds = {output: rng.choice(TYPES) for output in outputs}
    else:
        inputs, outputs = {port: like.inputs[port] for port in like.input_order}, like.outputs
        kinds = {}
        for output in outputs:
            endpoint = like.output_endpoint(output)
            kinds[output] = endpoint[0] if endpoint else rng.choice(TYPES)
    owners = [f"f{n}" for n in range(rng.choice((1, 1, 2)))]
    if like is not None and rng.random() < 0.8:
        owners = list(like.functionality_order)
    owned: dict[str, list[str]] = {owner: [] for owner in owners}
    for output in outputs:
        owned[rng.choice(owners)].append(output)
    functionalities = tuple(functionality(rng, owner, inputs, owned[owner], kinds) for owner in owners)
    return ComponentSpec.of(
        name,
        inputs=dict(sorted(inputs.items(), key=lambda _: rng.random())),
        outputs=outputs,
        functionalities=functionalities,
        resource_usage={"device": 1.0}
        if rng.random() < 0.25
        else {"memory": float(rng.choice((1, 2)))}
        if rng.random() < 0.4
        else {},
        parameters={"p": ParameterSpec(1, changeable=rng.random() < 0.5)} if rng.random() < 0.4 else {},
        run=f"python3 {name}.py",
        startup_seconds=rng.choice((None, 0.5, 2.0)),
    )


def functionality(
    rng: Random, name: str, inputs: dict[str, Predicate], outputs: list[str], kinds: dict[str, str]
) -> FunctionalitySpec:
    used = tuple(sorted(rng.sample(sorted(inputs), rng.randint(0, len(inputs)))))
    length = rng.choice((2, 2, 3, 4))
    chains = {output: guarantees(rng, kinds[output], length) for output in outputs}
    modes = []
    for place in range(length):
        stated = {output: chain[place] for output, chain in chains.items() if place < len(chain)}
        assumptions: list[Assumption] = []
        if place < length - 1:
            for _ in range(rng.choice((0, 1, 1, 2))):
                if used and rng.random() < 0.7:
                    assumptions.append(
                        InputAlternatives(tuple(sorted(rng.sample(used, rng.randint(1, min(2, len(used)))))))
                    )
                elif rng.random() < 0.8:
                    assumptions.append(predicate(rng))
        modes.append(Mode(f"m{place}", tuple(assumptions), Map(stated)))
    return FunctionalitySpec(name, tuple(modes), used, tuple(outputs), weight=float(rng.choice((1, 1, 2, 5))))


def guarantees(rng: Random, kind: str, length: int) -> list[Predicate]:
    """What one output guarantees in the first modes of a chain, each no more than the one before (rule M2)."""
    if rng.random() < 0.1:
        return []
    chain = [strong(rng, kind) if rng.random() < 0.8 else weakened(rng, strong(rng, kind))]
    while len(chain) < rng.choice((1, length - 1, length)):
        chain.append(weakened(rng, chain[-1], endpoint=True))
    return chain


def node(rng: Random, role: str, of: ComponentSpec, connectors: Map[str, Connector], density: float = 0.6) -> Node:
    """A node of ``of``, attached wherever the contracts allow it and chance has it."""
    attachments: dict[str, tuple[str, ...]] = {}
    for port in of.ports():
        fitting = [name for name in sorted(connectors) if fits(of, port, connectors[name])]
        chosen = [name for name in fitting if rng.random() < density]
        if len(chosen) > 1 and rng.random() < 0.6:
            chosen = chosen[:1]
        if chosen:
            attachments[port] = tuple(chosen)
    parameters = {"p": rng.choice((1, 2))} if "p" in of.parameters and rng.random() < 0.5 else {}
    return Node(role, of.name, Map(attachments), Map(parameters))


def fits(of: ComponentSpec, port: str, connector: Connector) -> bool:
    if port in of.outputs:
        return satisfies(of.owner(port).modes[0].guarantee(port), connector.guarantee)
    return satisfies(connector.guarantee, of.inputs[port])


def system(rng: Random, nodes: int = 5, topics: int = 4) -> Specification:
    """A specification without caps and with capacities that suffice: :func:`change` sets those."""
    connectors = {}
    for n in range(topics):
        plain = Predicate(rng.choice(TYPES), rng.choice((None, 5.0, 5.0)))
        connectors[f"/t{n}"] = Connector(f"/t{n}", predicate(rng, plain.type) if rng.random() < 0.2 else plain)
    components = {f"C{n}": component(rng, f"C{n}") for n in range(rng.randint(2, nodes))}
    for name in list(components):
        if rng.random() < 0.7:
            components[f"{name}b"] = component(rng, f"{name}b", like=components[name])
    environment: list[EnvironmentGuarantee] = []
    if rng.random() < 0.5:
        environment.append(EnvironmentGuarantee("world", predicate(rng)))
    if rng.random() < 0.3:
        topic = rng.choice(sorted(connectors))
        environment.append(EnvironmentGuarantee("replay", Predicate(connectors[topic].guarantee.type, 10.0), topic))
    table = Map(connectors)
    chosen = [(f"n{n}", components[rng.choice(sorted(components))]) for n in range(rng.randint(1, nodes))]
    return Specification(
        "random",
        connectors=table,
        components=Map(components),
        nodes=Map({role: node(rng, role, of, table) for role, of in chosen}),
        environment=tuple(environment),
        timing=Map({"remove": 0.25, "probation": 0.0}),
    )


def change(
    rng: Random, start: Specification, edits: int = 2, world: bool = True
) -> tuple[Specification, Specification]:
    """A start and a target: caps and capacities are drawn so that both ends meet them, often only just."""
    target = start
    for _ in range(rng.randint(1, edits)):
        target = edit(rng, target, world)
    return bounded(rng, *with_one_server(rng, start, target))


def with_services(rng: Random, start: Specification, target: Specification) -> tuple[Specification, Specification]:
    """Both with services and ROS actions in place of the topics of one type or of both."""
    kinds: dict[str, ConnectorKind] = dict(zip(TYPES, rng.choice(_KINDS_OF_TYPES), strict=True))
    return with_one_server(rng, *(_of_kinds(each, kinds) for each in (start, target)))


# The first type is that of all topics in `tight` and `exclusive`.
_KINDS_OF_TYPES: tuple[tuple[ConnectorKind, ConnectorKind], ...] = (
    ("service", "topic"),
    ("service", "action"),
    ("action", "topic"),
    ("action", "service"),
)


def _of_kinds(spec: Specification, kinds: dict[str, ConnectorKind]) -> Specification:
    def turned(contract: Predicate) -> Predicate:
        return of_kind(contract, kinds[contract.type])

    def assumed(assumption: Assumption) -> Assumption:
        return turned(assumption) if isinstance(assumption, Predicate) else assumption

    def mode(each: Mode) -> Mode:
        guarantees = {output: turned(contract) for output, contract in each.guarantees.items()}
        return replace(each, assumptions=tuple(map(assumed, each.assumptions)), guarantees=Map(guarantees))

    def component(of: ComponentSpec) -> ComponentSpec:
        functionalities = {each.name: replace(each, modes=tuple(map(mode, each.modes))) for each in of}
        inputs = {port: turned(contract) for port, contract in of.inputs.items()}
        return replace(of, inputs=Map(inputs), functionalities=Map(functionalities))

    return replace(
        spec,
        connectors=Map(
            {name: replace(each, guarantee=turned(each.guarantee)) for name, each in spec.connectors.items()}
        ),
        components=Map({name: component(of) for name, of in spec.components.items()}),
        environment=tuple(replace(offer, guarantee=turned(offer.guarantee)) for offer in spec.environment),
    )


def with_one_server(rng: Random, start: Specification, target: Specification) -> tuple[Specification, Specification]:
    """Both without all servers but one of each service and ROS action: at each end any of those, or one outside."""
    for name in sorted(start.connectors):
        if start.connectors[name].kind == "topic":
            continue
        outside = any(offer.topic == name for offer in start.environment)
        if outside and rng.random() < 0.5:
            outside = False
            start, target = (
                replace(spec, environment=tuple(offer for offer in spec.environment if offer.topic != name))
                for spec in (start, target)
            )
        start, target = (_served_by_one(rng, spec, name, outside) for spec in (start, target))
    return start, target


def _served_by_one(rng: Random, spec: Specification, name: str, outside: bool) -> Specification:
    servers = [
        (role, output)
        for role in sorted(spec.nodes)
        for output in spec.component_of(role).outputs
        if name in spec.nodes[role].attachments.get(output, ())
    ]
    kept = None if outside or not servers else rng.choice(servers)
    for role, output in servers:
        if (role, output) != kept:
            old = spec.nodes[role]
            left = tuple(each for each in old.attachments[output] if each != name)
            attachments = old.attachments.set(output, left) if left else old.attachments.delete(output)
            spec = spec.with_node(replace(old, attachments=attachments))
    return spec


def edit(rng: Random, target: Specification, world: bool) -> Specification:
    roles = sorted(target.nodes)
    kind = rng.choice(
        ("replace", "replace", "replace", "remove", "add", "rewire", "parameter", "contract", "environment")
    )
    if kind == "add" or not roles:
        role = f"added{len(roles)}"
        of = target.components[rng.choice(sorted(target.components))]
        return target.with_node(node(rng, role, of, target.connectors))
    role = rng.choice(roles)
    old = target.nodes[role]
    if kind == "remove":
        return target.without_node(role)
    if kind == "rewire":
        return target.with_node(node(rng, role, target.components[old.component], target.connectors))
    if kind == "parameter":
        declared = target.components[old.component].parameters
        return target.with_node(
            replace(old, parameters=Map({name: rng.choice((1, 2, 3)) for name in sorted(declared)}))
        )
    if kind == "contract" and world:
        name = rng.choice(sorted(target.connectors))
        changed = replace(target.connectors[name], guarantee=predicate(rng, target.connectors[name].guarantee.type))
        return refitted(replace(target, connectors=target.connectors.set(name, changed)))
    if kind == "environment" and world:
        return replace(
            target,
            environment=(*target.environment, EnvironmentGuarantee(f"more{len(target.environment)}", predicate(rng))),
        )
    alike = [
        c for c in sorted(target.components) if target.components[c].ports() and _same_ports(target, old.component, c)
    ]
    name = rng.choice(alike or sorted(target.components))
    of = target.components[name]
    if rng.random() < 0.3:
        of = replace(of, name=f"{name}x", run="python3 other.py", functionality_order=of.functionality_order)
        target = replace(target, components=target.components.set(of.name, of))
    kept = {port: topics for port, topics in old.attachments.items() if port in of.ports()}
    return refitted(target.with_node(Node(role, of.name, Map(kept), Map())), role)


def _same_ports(spec: Specification, one: str, other: str) -> bool:
    return set(spec.components[one].ports()) == set(spec.components[other].ports())


def refitted(target: Specification, only: str | None = None) -> Specification:
    """Without the attachments whose contracts do not fit any more."""
    for role in sorted(target.nodes) if only is None else [only]:
        old, of = target.nodes[role], target.component_of(role)
        kept = {}
        for port, topics in old.attachments.items():
            fitting = tuple(topic for topic in topics if fits(of, port, target.connectors[topic]))
            if fitting:
                kept[port] = fitting
        target = target.with_node(replace(old, attachments=Map(kept)))
    return target


def bounded(rng: Random, start: Specification, target: Specification) -> tuple[Specification, Specification]:
    caps: dict[str, int] = {}
    for name in sorted(target.connectors):
        ends = [publishers(spec, name) for spec in (start, target) if name in spec.connectors]
        if rng.random() < 0.5 and max(ends) > 0:
            caps[name] = max(ends)
    every = {resource for spec in (start, target) for of in spec.components.values() for resource in of.resource_usage}
    demand = dict.fromkeys(sorted(every), 1.0)
    for spec in (start, target):
        held: dict[str, float] = {}
        for role in spec.nodes:
            for resource, amount in spec.component_of(role).resource_usage.items():
                held[resource] = held.get(resource, 0.0) + amount
        for resource, amount in held.items():
            demand[resource] = max(demand[resource], amount)
    slack = rng.choice((0.0, 0.0, 1.0, 100.0))
    resources = Map({name: Resource(name, amount + slack) for name, amount in demand.items()})

    def bound(spec: Specification) -> Specification:
        connectors = {name: replace(c, max_publishers=caps.get(name)) for name, c in spec.connectors.items()}
        return replace(spec, connectors=Map(connectors), resources=resources)

    return bound(start), bound(target)


def unbounded(spec: Specification) -> Specification:
    """The same without caps, and with room for everything."""
    connectors = {name: replace(c, max_publishers=None) for name, c in spec.connectors.items()}
    resources = {name: Resource(name, 1000.0) for name in spec.resources}
    return replace(spec, connectors=Map(connectors), resources=Map(resources))


def publishers(spec: Specification, topic: str) -> int:
    attached = sum(
        topic in spec.nodes[role].attachments.get(output, ())
        for role in spec.nodes
        for output in spec.component_of(role).outputs
    )
    return attached + sum(offer.topic == topic for offer in spec.environment)


def constrained(rng: Random, start: Specification, target: Specification) -> Specification:
    """The target with a few constraints of the user's, of roles that it has."""
    roles = sorted(set(start.nodes) & set(target.nodes))
    chosen: list[Keep | Limit | Order] = []
    for _ in range(rng.randint(1, 3)):
        if not roles:
            break
        role = rng.choice(roles)
        functionality = rng.choice(list(target.component_of(role)))
        ref = FunctionalityRef(role, functionality.name)
        kind = rng.randrange(3)
        if kind == 0:
            chosen.append(Keep(ref, rng.choice(functionality.modes).name))
        elif kind == 1:
            chosen.append(Limit(ref, rng.choice((0.0, 1.0, 5.0))))
        else:
            chosen.append(Order(role, rng.choice(sorted(target.nodes))))
    return replace(target, constraints=tuple(dict.fromkeys(chosen)))


def tight(rng: Random, replaced: int) -> tuple[Specification, Specification]:
    """Nodes in chains that are all replaced, while they share two resources of which there is hardly enough.

    Between each two of them is a topic, often an exclusive one; at the end of each chain is a node that stays.
    """
    predicate = Predicate(TYPES[0], 5.0)
    connectors, components, nodes, succession = {}, {}, {}, {}
    before: str | None = None
    for number in range(replaced):
        role, topic = f"n{number}", f"/t{number}"
        connectors[topic] = Connector(topic, predicate, 1 if rng.random() < 0.4 else None)
        read = before if before is not None and rng.random() < 0.6 else None
        inputs = {"in": predicate} if read else {}
        writes = rng.random() < 0.8
        weight, modes = float(rng.choice((1, 1, 2, 5))), rng.choice((2, 2, 3))
        for kind in ("Old", "New"):
            chain = [
                Mode("m0", (InputAlternatives(("in",)),) if read else (), Map({"out": predicate} if writes else {}))
            ]
            chain += [Mode(f"m{place}", (), Map()) for place in range(1, modes)]
            components[f"{kind}{number}"] = ComponentSpec.of(
                f"{kind}{number}",
                inputs=inputs,
                outputs=("out",) if writes else (),
                functionalities=(
                    FunctionalitySpec("f", tuple(chain), tuple(inputs), ("out",) if writes else (), weight),
                ),
                resource_usage={name: float(rng.randint(1, 3)) for name in ("cpu", "gpu") if rng.random() < 0.7},
                run=f"python3 {kind}{number}.py",
                startup_seconds=rng.choice((0.5, 1.0, 2.0)),
            )
        attachments = {"in": (read,)} if read else {}
        nodes[role] = Node(role, f"Old{number}", Map({**attachments, **({"out": (topic,)} if writes else {})}))
        succession[role] = f"New{number}"
        before = topic if writes else before
    if before is not None:
        components["User"] = ComponentSpec.of(
            "User",
            inputs={"in": predicate},
            functionalities=(
                FunctionalitySpec("f", (Mode("m", (InputAlternatives(("in",)),)), Mode("d")), ("in",), (), 2.0),
            ),
            run="python3 User.py",
        )
        nodes["user"] = Node("user", "User", Map({"in": (before,)}))
    start = Specification(
        "tight",
        connectors=Map(connectors),
        components=Map(components),
        nodes=Map(nodes),
        timing=Map({"remove": rng.choice((0.25, 0.5)), "probation": 0.0}),
    )
    target = start
    for role, of in succession.items():
        target = target.with_replaced(role, of)
    held = [
        [sum(spec.component_of(role).resource_usage.get(name, 0.0) for role in spec.nodes) for spec in (start, target)]
        for name in ("cpu", "gpu")
    ]
    resources = Map(
        {
            name: Resource(name, max(*amounts, 1.0) + rng.choice((0.0, 0.0, 1.0, 2.0)))
            for name, amounts in zip(("cpu", "gpu"), held, strict=True)
        }
    )
    return replace(start, resources=resources), replace(target, resources=resources)


def exclusive(rng: Random, roles: int) -> tuple[Specification, Specification]:
    """Nodes that write topics with caps, and from start to target exchange these or are replaced, at random.

    Some read what others write, so a new one may be silent at first, and cannot take a topic over. Some hold a device.
    """
    predicate = Predicate(TYPES[0], 5.0)
    topics = [f"/t{number}" for number in range(roles)]
    caps = {topic: rng.choice((1, 1, 2, None)) for topic in topics}
    components, pair = {}, dict[str, list[Node]]()
    ends: list[dict[str, tuple[str, ...]]] = []
    for _ in range(2):
        shuffled = rng.sample(topics, len(topics))
        end: dict[str, tuple[str, ...]] = {f"n{number}": (topic,) for number, topic in enumerate(shuffled)}
        for role in end:
            more = rng.choice(topics)
            taken = sum(more in some for some in end.values())
            if more not in end[role] and rng.random() < 0.4 and taken < (caps[more] or roles):
                end[role] = (*end[role], more)
        ends.append(end)
    for role in ends[0]:
        stays = rng.random() < 0.4
        reads = tuple(rng.sample(topics, 1)) if rng.random() < 0.4 else ()
        holds = {"device": 1.0} if rng.random() < 0.3 else {}
        for kind in ("Stay",) if stays else ("Old", "New"):
            normal = Mode("m0", (InputAlternatives(("in",)),) if reads else (), Map({"out": predicate}))
            chain = (normal, Mode("m1", (), Map({"out": predicate}) if rng.random() < 0.2 else Map()))
            components[f"{kind}{role}"] = ComponentSpec.of(
                f"{kind}{role}",
                inputs={"in": predicate} if reads else {},
                outputs=("out",),
                functionalities=(
                    FunctionalitySpec("f", chain, ("in",) if reads else (), ("out",), float(rng.choice((1, 2, 5)))),
                ),
                resource_usage=holds,
                run=f"python3 {kind}{role}.py",
                startup_seconds=rng.choice((0.5, 1.0, 2.0)),
            )
        pair[role] = [
            Node(role, f"{kind}{role}", Map({"out": end[role], **({"in": reads} if reads else {})}))
            for kind, end in zip(("Stay", "Stay") if stays else ("Old", "New"), ends, strict=True)
        ]
    held = sum(components[nodes[0].component].resource_usage.get("device", 0.0) for nodes in pair.values())
    start, target = (
        Specification(
            "exclusive",
            connectors=Map({topic: Connector(topic, predicate, cap) for topic, cap in caps.items()}),
            components=Map(components),
            nodes=Map({role: nodes[end] for role, nodes in pair.items()}),
            resources=Map({"device": Resource("device", max(held, 1.0))}),
            timing=Map({"remove": 0.25, "probation": 0.0}),
        )
        for end in range(2)
    )
    return start, target


def degraded(
    rng: Random, start: Specification, target: Specification
) -> tuple[Configuration, Specification, Specification]:
    """What runs when some functionalities have degraded, its specification and the target.

    Either some have by themselves, and can be raised again; or what the environment guaranteed is gone, and the target
    does without it.
    """
    running = initial(start)
    if target.environment and rng.random() < 0.6:
        target = replace(target, environment=target.environment[1:])
        return running.with_modes(best(running.with_context(target.context)).modes), start, target
    refs = sorted(running.modes)
    fallen = {ref: running.functionality(ref).last_mode for ref in rng.sample(refs, min(len(refs), 2))}
    running = running.with_modes(fallen)
    consumers = [other for ref in fallen for other in running.downstream(ref)]
    return running.with_modes(lowered(running, consumers)), start, target


def with_programs(rng: Random, start: Specification, target: Specification) -> tuple[Specification, Specification]:
    """Both with programs that end (`once`): of each role, both, either or neither has one, of the same or another."""
    programs = {
        name: ComponentSpec.of(name, run=f"./{name}", once=True, gate="none", startup_seconds=rng.choice((None, 2.0)))
        for name in ("Spawn", "Home")
    }
    found = []
    for specification in (start, target):
        specification = replace(specification, components=specification.components.update(programs))
        for role in ("spawner", "homing"):
            if rng.random() < 0.7:
                specification = specification.with_node(Node(role, rng.choice(("Spawn", "Home"))))
        found.append(specification)
    return found[0], found[1]
