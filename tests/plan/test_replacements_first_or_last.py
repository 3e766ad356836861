"""Replacements that are made first or last: the least cost is the same, and there is a way that has it."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

import pytest
from immutables import Map

from benchmarks._conflict_core_systems import instance
from midstride.model.component import ComponentSpec, Connector, FunctionalitySpec, InputAlternatives, Mode, Resource
from midstride.model.contract import Predicate
from midstride.model.specification import Node, Specification, initial
from midstride.plan.change import Change
from midstride.plan.change_builder import change_between
from midstride.plan.core.conflict_core import Part, parts
from midstride.plan.core.core_losses import PartLosses, fullest
from midstride.plan.core.core_search import PartResult, PartSearch
from midstride.plan.core.lossless_steps import Ends
from midstride.plan.disruption import Levels
from tests.plan import systems


def shared(rng: Random) -> tuple[Specification, Specification]:
    """Replacements that write topics together, up to the cap of each; some have two outputs on one topic."""
    predicate, topics = Predicate("std_msgs/msg/Header", 5.0), {"/a": 2, "/b": 1, "/c": 2}
    together: dict[str, tuple[str, ...]] = {"n0": ("/a",), "n1": ("/a",), "n2": ("/b",)}
    twice: dict[str, tuple[str, ...]] = {"n2": ("/b",), "n3": ("/c", "/c")}
    writes = rng.choice((together, twice))
    components, nodes = {}, {}
    held = {"Old": 0.0, "New": 0.0}
    for role, its in writes.items():
        ports = tuple(f"out{place}" for place, _ in enumerate(its))
        normal, weight = Mode("normal", (), Map(dict.fromkeys(ports, predicate))), float(rng.choice((1, 2, 5)))
        works = FunctionalitySpec("f", (normal, Mode("off")), (), ports, weight)
        for kind in held:
            memory, name = float(rng.randint(1, 4)), f"{kind}{role}"
            held[kind] += memory
            components[name] = ComponentSpec.of(
                name,
                outputs=ports,
                functionalities=(works,),
                resource_usage={"memory": memory},
                run=f"python3 {name}.py",
                startup_seconds=1.0,
            )
        nodes[role] = Node(role, f"Old{role}", Map({port: (topic,) for port, topic in zip(ports, its, strict=True)}))
    reads = FunctionalitySpec("f", (Mode("all", (InputAlternatives(("in",)),)), Mode("off")), ("in",), (), 3.0)
    components["User"] = ComponentSpec.of(
        "User", inputs={"in": predicate}, functionalities=(reads,), run="python3 User.py"
    )
    nodes["user"] = Node("user", "User", Map({"in": (rng.choice(writes["n2"]),)}))
    start = Specification(
        "shared",
        connectors=Map({topic: Connector(topic, predicate, cap) for topic, cap in topics.items()}),
        components=Map(components),
        nodes=Map(nodes),
        resources=Map(memory=Resource("memory", max(held.values()) + rng.choice((0.0, 1.0, 3.0)))),
    )
    target = start
    for role in writes:
        target = target.with_replaced(role, f"New{role}")
    return start, target


FAMILIES: dict[str, Callable[[int], tuple[Specification, Specification]]] = {
    "two resources": lambda seed: systems.tight(Random(seed), 3 + seed % 2),
    "exclusive topics": lambda seed: systems.exclusive(Random(seed), 4),
    "conflict cores": instance,
    "shared topics": lambda seed: shared(Random(seed)),
}


# The largest part that is searched without the bounds, by the number of its actions.
SMALL = 14


def least(part: Part, losses: PartLosses) -> float:
    """The least cost, from the definition: every order of the actions, each state once."""
    known: dict[int, float] = {}

    def rest(state: int) -> float:
        if state not in known:
            known[state] = float("inf")
            undone = [bit for bit in range(len(part.ops)) if not state >> bit & 1]
            if all(part.ops[bit].kind == "detach" for bit in undone):
                known[state] = 0.0
            else:
                moves = [1 << bit for bit in undone]
                moves += [1 << a | 1 << b for a in undone for b in undone if kinds(part, a, b) == ("detach", "attach")]
                costs = (step_cost(part, losses, state, move) for move in moves)
                known[state] = min(
                    (cost + rest(state | move) for move, cost in zip(moves, costs, strict=True) if cost is not None),
                    default=float("inf"),
                )
        return known[state]

    return rest(0)


def kinds(part: Part, *bits: int) -> tuple[str, ...]:
    return tuple(part.ops[bit].kind for bit in bits)


def step_cost(part: Part, losses: PartLosses, state: int, move: int) -> float | None:
    """What a set of actions costs that are done at once; None where it is not possible."""
    after, cost = state | move, 0.0
    for bit in (bit for bit in range(len(part.ops)) if move >> bit & 1):
        op = part.ops[bit]
        needed = part.live[bit] | part.after[bit]
        if state & needed != needed:
            return None
        if op.kind == "create":
            done = [part.usage[b] for b in range(len(part.ops)) if state >> b & 1]
            if any(n > 0 and f < n + sum(u) for n, f, *u in zip(part.usage[bit], part.free, *done, strict=True)):
                return None
            cost += part.seconds[bit] * losses.loss(state)
        elif op.kind == "remove":
            own = [b for b, each in enumerate(part.ops) if each.kind == "detach" and each.instance == op.instance]
            cost += part.seconds[bit] * losses.loss(after | sum(1 << b for b in own))
            after |= sum(1 << b for b in own)
    for topic in part.topics:
        if topic.free + (after & topic.detach).bit_count() < (after & topic.attach).bit_count():
            return None
    return cost


def check_way(part: Part, losses: PartLosses, moves: tuple[int, ...], cost: float) -> None:
    state, total = 0, 0.0
    for move in moves:
        step = step_cost(part, losses, state, move)
        assert step is not None and not state & move
        state, total = state | move, total + step
    assert total == pytest.approx(cost)
    assert all(part.ops[bit].kind == "detach" for bit in range(len(part.ops)) if not state >> bit & 1)


@pytest.mark.parametrize(
    ("family", "seeds"),
    [
        ("two resources", 40),
        pytest.param("two resources", 120, marks=pytest.mark.full),
        ("exclusive topics", 60),
        ("conflict cores", 5),
        ("shared topics", 30),
        pytest.param("conflict cores", 30, marks=pytest.mark.full),
    ],
)
def test_the_least_cost_is_that_of_all_orders(family: str, seeds: int) -> None:
    """Whatever is known: the less is left to the known cost, the more replacements are made first or last."""
    first = last = 0
    for seed in range(seeds):
        change = _change(FAMILIES[family](seed))
        levels, full = Levels(change), fullest(change)
        for part in parts(change, ()):
            losses = PartLosses(change, part, levels, full)
            if len(part.ops) > SMALL or (exact := least(part, losses)) == float("inf"):
                continue
            search = PartSearch(part, losses, {})
            for more in (1e-3, 1.0, 20.0, 500.0):
                found = search.run(lambda: False, PartResult(0.0, exact + more))
                assert [found.lower_bound, found.cost] == pytest.approx([exact, exact]), (seed, more)
                check_way(part, losses, found.moves, exact)
            assert search.run(lambda: False, PartResult(0.0, exact)).lower_bound == pytest.approx(exact)
            ends = Ends(part, losses, search.bounds)
            numbers = ends.never_absent(0, exact - search.bounds.of_roles(0))
            first += ends.first(0, numbers, 0) != 0
            last += ends.last(numbers)[0] != 0
    assert family == "exclusive topics" or (first > 0 and last > 0), "some are made first, some last"


def _change(ends: tuple[Specification, Specification]) -> Change:
    start, target = ends
    return change_between(initial(start), start, target)
