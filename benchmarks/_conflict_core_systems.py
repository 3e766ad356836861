"""The published set of hard changes: 100 robots, in each of which 60 actions are tied together.

A robot has one to six computers, with memory and in most cases a GPU that the nodes to replace need more of than there
is. Some of them publish on exclusive topics. Around them are nodes that stay, in layers, 200 functionalities in all.
Everything follows from the seed. The set was fixed before the planner was tuned.
"""

from __future__ import annotations

from random import Random
from typing import Final

from immutables import Map

from midstride.model.component import ComponentSpec, Connector, FunctionalitySpec, InputAlternatives, Mode, Resource
from midstride.model.contract import Predicate
from midstride.model.specification import Node, Specification

SEEDS: Final = range(100)
TIED: Final = 60
FUNCTIONALITIES: Final = 200
NEED: Final = Predicate("std_msgs/msg/Header", 10.0)


def instance(
    seed: int, tied: int = TIED, functionalities: int = FUNCTIONALITIES
) -> tuple[Specification, Specification]:
    """The start and the target of one change."""
    rng = Random(seed)
    computers = rng.choice((1, 2, 2, 3, 3, 4, 5, 6))
    exclusive = rng.randint(
        4, 12
    )  # creating, removing, attaching and detaching are tied; of the others, only the first two
    replaced = exclusive + (tied - 4 * exclusive) // 2
    connectors: dict[str, Connector] = {}
    components: dict[str, ComponentSpec] = {}
    nodes: dict[str, Node] = {}
    succession: dict[str, str] = {}
    topics: list[str] = []
    order = list(range(replaced))
    rng.shuffle(order)
    for number in range(replaced):
        role, topic, computer = f"n{number:02}", f"/n{number:02}", number % computers
        connectors[topic] = Connector(topic, NEED, 1 if order[number] < exclusive else None)
        reads = rng.sample(topics, min(len(topics), rng.choice((0, 1, 1, 2))))
        work = _work(rng, reads, [topic])
        holds = [{f"memory{computer}": float(rng.randint(1, 6))} for _ in range(2)]
        if computer % 3 != 2 and rng.random() < 0.6:
            for each in holds:
                each[f"gpu{computer}"] = float(rng.randint(1, 4))
        seconds = rng.choice((0.5, 1.0, 1.5, 2.0, 4.0))
        for kind, held in zip(("Old", "New"), holds, strict=True):
            components[f"{kind}{number:02}"] = _component(f"{kind}{number:02}", work, reads, [topic], held, seconds)
        nodes[role] = _node(role, f"Old{number:02}", reads, [topic])
        succession[role] = f"New{number:02}"
        topics.append(topic)
    for number in range(functionalities - replaced):
        role, topic = f"s{number:03}", f"/s{number:03}"
        connectors[topic] = Connector(topic, NEED)
        reads = sorted(rng.sample(topics, rng.choice((1, 1, 2, 3))))
        components[f"Stay{number:03}"] = _component(
            f"Stay{number:03}", _work(rng, reads, [topic]), reads, [topic], {}, 1.0
        )
        nodes[role] = _node(role, f"Stay{number:03}", reads, [topic])
        topics.append(topic)
    start = Specification(
        f"core{seed}", connectors=Map(connectors), components=Map(components), nodes=Map(nodes), timing=Map(remove=0.25)
    )
    target = start
    for role, name in succession.items():
        target = target.with_replaced(role, name)
    amounts: dict[str, list[float]] = {}
    for place, spec in enumerate((start, target)):
        for role in spec.nodes:
            for resource, amount in spec.component_of(role).resource_usage.items():
                amounts.setdefault(resource, [0.0, 0.0])[place] += amount
    resources = {name: Resource(name, max(amounts[name]) + rng.randint(0, 2)) for name in sorted(amounts)}
    return _with(start, resources), _with(target, resources)


def _with(spec: Specification, resources: dict[str, Resource]) -> Specification:
    return Specification(
        spec.name, spec.connectors, spec.components, spec.nodes, resources=Map(resources), timing=spec.timing
    )


def _work(rng: Random, reads: list[str], writes: list[str]) -> FunctionalitySpec:
    """Needs all of its topics, or any of them; a third work on with one of them, if less well."""
    inputs, guaranteed = tuple(_port(topic) for topic in reads), Map(dict.fromkeys(map(_port, writes), NEED))
    each = tuple(InputAlternatives((name,)) for name in inputs)
    needs = (InputAlternatives(inputs),) if len(inputs) > 1 and rng.random() < 0.3 else each
    modes = [Mode("normal", needs, guaranteed)]
    if len(inputs) > 1 and needs == each and rng.random() < 0.33:
        modes.append(Mode("partly", (InputAlternatives(inputs),), guaranteed))
    modes.append(Mode("degraded"))
    weight = float(rng.choice((1, 1, 1, 2, 3, 5)))
    return FunctionalitySpec("work", tuple(modes), inputs, tuple(map(_port, writes)), weight)


def _component(
    name: str, work: FunctionalitySpec, reads: list[str], writes: list[str], holds: dict[str, float], seconds: float
) -> ComponentSpec:
    return ComponentSpec.of(
        name,
        inputs={_port(topic): NEED for topic in reads},
        outputs=tuple(map(_port, writes)),
        functionalities=(work,),
        resource_usage=holds,
        run=f"python3 {name.lower()}.py",
        startup_seconds=seconds,
    )


def _node(role: str, of: str, reads: list[str], writes: list[str]) -> Node:
    return Node(role, of, Map({_port(topic): (topic,) for topic in (*reads, *writes)}))


def _port(topic: str) -> str:
    return topic[1:]
