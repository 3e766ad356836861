"""The lower bounds of a part of the conflict core, against slow twins that try every set and every order."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace as changed
from itertools import combinations, permutations, product
from math import inf
from random import Random
from typing import TypeAlias

import pytest
from immutables import Map

from midstride.model.component import ComponentSpec, FunctionalitySpec, Mode, Resource
from midstride.model.specification import Node, Specification
from midstride.plan.core import core_bounds
from midstride.plan.core.conflict_core import Part, parts
from midstride.plan.core.core_bounds import Replaced, RoleBounds
from midstride.plan.core.core_losses import PartLosses, fullest
from midstride.plan.core.core_search import PartResult, PartSearch
from midstride.plan.disruption import Levels
from tests.plan import systems
from tests.plan.test_core import between
from tests.plan.test_replacements_first_or_last import shared

Family: TypeAlias = Callable[[Random, int], tuple[Specification, Specification]]

# So many states of each part are looked at, drawn from the seed.
STATES = 12


def bounded(seed: int, replaced: int, family: Family = systems.tight) -> Iterator[RoleBounds]:
    change = between(family(Random(seed), replaced))
    levels, full = Levels(change), fullest(change)
    for part in parts(change, ()):
        yield RoleBounds(part, PartLosses(change, part, levels, full))


def crowded(rng: Random, replaced: int) -> tuple[Specification, Specification]:
    """Replacements that share a memory, in which several of the old ones have to go before the new ones fit."""
    components: dict[str, ComponentSpec] = {}
    nodes: dict[str, Node] = {}
    held = {"Old": 0.0, "New": 0.0}
    for number in range(replaced):
        works = FunctionalitySpec("f", (Mode("on"), Mode("off")), weight=rng.choice((1.0, 1.5, 1.75, 30.0)))
        for kind in held:
            memory, name = rng.choice({"Old": (2.0, 2.0, 3.0), "New": (1.0, 1.0, 6.0)}[kind]), f"{kind}{number}"
            held[kind] += memory
            components[name] = ComponentSpec.of(
                name, functionalities=(works,), resource_usage={"memory": memory}, run=name, startup_seconds=1.0
            )
        nodes[f"n{number}"] = Node(f"n{number}", f"Old{number}", Map())
    start = Specification(
        "crowded",
        components=Map(components),
        nodes=Map(nodes),
        resources=Map(memory=Resource("memory", max(held.values()) + rng.choice((0.0, 1.0)))),
    )
    target = start
    for number in range(replaced):
        target = target.with_replaced(f"n{number}", f"New{number}")
    return start, target


def grown(rng: Random, replaced: int) -> tuple[Specification, Specification]:
    """As ``crowded``, with a node that is new: only others can make room for it."""
    start, target = crowded(rng, replaced)
    memory = float(rng.randint(2, 4))
    extra = ComponentSpec.of(
        "Extra",
        functionalities=(FunctionalitySpec("f", (Mode("on"), Mode("off"))),),
        resource_usage={"memory": memory},
        run="extra",
        startup_seconds=2.0,
    )
    held = sum(target.component_of(role).resource_usage["memory"] for role in target.nodes)
    room = Resource("memory", max(start.resources["memory"].capacity, held + memory))
    start, target = (
        changed(each, components=each.components.set("Extra", extra), resources=Map(memory=room))
        for each in (start, target)
    )
    return start, target.with_node(Node("extra", "Extra", Map()))


FAMILIES: dict[str, Family] = {
    "tight": systems.tight,
    "crowded": crowded,
    "grown": grown,
    "exclusive": systems.exclusive,
    "shared": lambda rng, _: shared(rng),
}


def is_possible(part: Part, done: int) -> bool:
    """Whether nothing that has to be created first has been done without it."""
    return all(not part.live[bit] & ~done for bit in bits(done))


def bits(mask: int) -> list[int]:
    return [bit for bit in range(mask.bit_length()) if mask >> bit & 1]


def timed_states(bounds: RoleBounds, rng: Random) -> list[int]:
    timed = bits(bounds.timed)
    drawn = {sum(1 << bit for bit in timed if rng.random() < 0.4) for _ in range(STATES)}
    return sorted({0, *(state for state in drawn if is_possible(bounds.part, state))})


def least_absences(bounds: RoleBounds, state: int, resource: int) -> float:
    """What the roles cost more, at least, of which the old one goes first, so that each other one fits in some order.

    0 where no set of them is enough.
    """
    part = bounds.part
    waiting = [each for each in bounds.replacements if not state & (each.remove | each.create)]
    replaced = sum(each.remove for each in waiting)
    free = part.free[resource]
    for bit in bits(bounds.timed):
        amount = part.usage[bit][resource]
        leaves = amount < 0 and not replaced >> bit & 1 and not part.live[bit] & ~state
        if state >> bit & 1 or leaves:
            free -= amount

    def fits(order: tuple[Replaced, ...], room: int) -> bool:
        for each in order:
            if each.new[resource] > room:
                return False
            room += each.old[resource] - each.new[resource]
        return True

    best = inf
    for size in range(len(waiting) + 1):
        for absent in combinations(waiting, size):
            room = free + sum(each.old[resource] for each in absent)
            if any(fits(order, room) for order in permutations(each for each in waiting if each not in absent)):
                best = min(best, sum(each.extra for each in absent))
    return 0.0 if best == inf else best


@pytest.mark.parametrize(("family", "replaced"), [("tight", 4), ("crowded", 4), ("crowded", 5)])
def test_the_bound_adds_the_cheapest_set_of_roles_that_make_room(family: str, replaced: int) -> None:
    several = 0
    for seed in range(20):
        for bounds in bounded(seed, replaced, FAMILIES[family]):
            for state in timed_states(bounds, Random(seed)):
                resources = range(len(bounds.part.free))
                room = max((least_absences(bounds, state, resource) for resource in resources), default=0.0)
                found = bounds.of(state) - bounds.of_roles(state)
                assert found == pytest.approx(room, abs=1e-6), f"seed {seed}, {state:b}"
                single = (each.extra for each in bounds.replacements)
                several += found > 0.0 and all(abs(found - extra) > 1e-6 for extra in single)
    assert several or family == "tight", "now and then, two have to be absent at the same time"


def test_where_only_a_few_sets_are_looked_at_the_next_one_is_the_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    exact = {seed: [bounds.of(0) - bounds.of_roles(0) for bounds in bounded(seed, 5, crowded)] for seed in range(40)}
    monkeypatch.setattr(core_bounds, "_SETS", 1)
    looser = 0
    for seed, rooms in exact.items():
        for bounds, room in zip(bounded(seed, 5, crowded), rooms, strict=True):
            found = bounds.of(0) - bounds.of_roles(0)
            assert found <= room + 1e-9
            assert not room or found, "the second set costs something too"
            looser += found < room - 1e-6
    assert looser


# -- one role, and what others have to free for it -----------------------------------------------------------


def least_loss_with_room(bounds: RoleBounds, mask: int, own: int, bit: int) -> float:
    """Over all states of the other roles that leave room for ``bit``, each as favourable as it can be."""
    part = bounds.part
    others = [each for each in bounds.masks if each != mask]
    options = [
        [state for state in submasks(each) if is_possible(part, state)] for each in others
    ]  # a role's actions are about its own instances
    best = inf
    for chosen in product(*options):
        done = own | sum(chosen)
        used = [sum(part.usage[b][resource] for b in bits(done)) for resource in range(len(part.free))]
        needed = part.usage[bit]
        if all(not n or n + u <= free for n, u, free in zip(needed, used, part.free, strict=True)):
            best = min(best, bounds.losses.loss(favourable(part, done)))
    return best


def submasks(mask: int) -> list[int]:
    places = bits(mask)
    return [
        sum(1 << bit for bit, chosen in zip(places, choice, strict=True) if chosen)
        for choice in product((False, True), repeat=len(places))
    ]


def favourable(part: Part, done: int) -> int:
    """The state in which everything is attached, and nothing is detached but what has been removed."""
    removed = {part.ops[bit].instance for bit in bits(done) if part.ops[bit].kind == "remove"}
    for bit, op in enumerate(part.ops):
        if op.kind == "attach" or (op.kind == "detach" and op.instance in removed):
            done |= 1 << bit
    return done


def least_of_role(bounds: RoleBounds, mask: int, own: int) -> float:
    """What the actions of one role cost at least that are not in ``own``, in every order."""
    part = bounds.part
    if own == mask:
        return 0.0
    best = inf
    for bit in bits(mask & ~own):
        if part.live[bit] & bounds.timed & ~own:
            continue
        if part.ops[bit].kind == "create":
            lost = least_loss_with_room(bounds, mask, own, bit)
        else:
            lost = bounds.losses.loss(favourable(part, own | 1 << bit | creations(bounds, mask)))
        best = min(best, lost * part.seconds[bit] + least_of_role(bounds, mask, own | 1 << bit))
    return best


def creations(bounds: RoleBounds, mask: int) -> int:
    """What can come of the other roles."""
    return sum(1 << bit for bit in bits(bounds.timed & ~mask) if bounds.part.ops[bit].kind == "create")


@pytest.mark.parametrize(
    ("family", "replaced", "figures"),
    [
        ("tight", 3, (416, 2)),
        ("tight", 4, (555, 2)),
        ("crowded", 4, (640, 0)),
        ("grown", 4, (720, 0)),
        ("exclusive", 5, (286, 2)),
    ],
)
def test_the_bound_of_a_role_is_at_most_the_least_of_all_states_of_the_others_and_mostly_equal(
    family: str, replaced: int, figures: tuple[int, int]
) -> None:
    equal = looser = 0
    for seed in range(40):
        for bounds in bounded(seed, replaced, FAMILIES[family]):
            for mask in bounds.masks:
                for own in submasks(mask):
                    if not is_possible(bounds.part, own):
                        continue
                    # Of the other roles all is done, so that the bound is of this one alone.
                    state = own | sum(each for each in bounds.masks if each != mask)
                    exact = least_of_role(bounds, mask, own)
                    assert bounds.of_roles(state) <= exact + 1e-9, f"seed {seed}: {own:b}"
                    if bounds.of_roles(state) >= exact - 1e-9:
                        equal += 1
                    else:
                        looser += 1
    assert (equal, looser) == figures


def cheapest(offers: list[tuple[float, int, float]], needed: int, alone: float) -> float:
    best = inf
    for size in range(len(offers) + 1):
        for chosen in combinations(offers, size):
            if sum(gain for _, gain, _ in chosen) >= needed:
                best = min(best, max([alone + sum(added for added, _, _ in chosen), *(pair for *_, pair in chosen)]))
    return best


@pytest.mark.parametrize("seed", range(100))
def test_the_cheapest_set_of_offers_that_frees_enough(seed: int) -> None:
    rng = Random(seed)
    offers = [(float(rng.randint(0, 4)), rng.randint(1, 4), float(rng.randint(0, 6))) for _ in range(rng.randint(0, 6))]
    needed, alone = rng.randint(1, 9), float(rng.randint(0, 3))
    assert core_bounds._cheapest(offers, needed, alone) == cheapest(offers, needed, alone)


# -- what the bounds are for ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("family", "replaced", "figures"),
    [
        ("tight", 4, (41, 41, 396)),
        ("crowded", 6, (40, 40, 1252)),
        ("exclusive", 5, (69, 69, 463)),
        ("shared", 3, (41, 41, 407)),
    ],
)
def test_the_search_looks_at_few_states(family: str, replaced: int, figures: tuple[int, int, int]) -> None:
    """A looser bound, or a rule that leaves fewer ways out, shows in nothing else: the plans are the same."""
    looked_at = beams = ways = 0

    def stop() -> bool:
        nonlocal looked_at
        looked_at += 1
        return looked_at > 20_000

    for seed in range(40):
        change = between(FAMILIES[family](Random(seed), replaced))
        levels, full = Levels(change), fullest(change)
        for part in parts(change, ()):
            search = PartSearch(part, PartLosses(change, part, levels, full), {})
            result = search.run(stop, PartResult(0.0))
            beams += search.beam().cost <= result.cost + 1e-9
            ways += 1
    assert (ways, beams, looked_at) == figures
