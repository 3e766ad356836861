"""The order of mode changes: singles wherever they do, else a smallest group; and from what is not valid any more."""

from __future__ import annotations

from itertools import combinations

from hypothesis import given
from hypothesis import strategies as st
from immutables import Map

from midstride.model.action import Degrade, Upgrade
from midstride.model.best import best, lowered
from midstride.model.component import FunctionalityRef, Mode
from midstride.model.configuration import Configuration
from midstride.model.specification import initial, structure
from midstride.plan.strategies.mode_ordering import degradations, upgrades
from midstride.plan.strongly_connected import strongly_connected
from tests.plan.cases import SLOW, component, functionality, system, work
from tests.strategies.systems import configurations


def at(text: str) -> FunctionalityRef:
    return FunctionalityRef.parse(text)


def groups(actions: list[Degrade] | list[Upgrade]) -> list[list[str]]:
    return [sorted(str(ref) for ref in action.modes) for action in actions]


def ring(size: int, prefix: str = "n") -> dict[str, tuple[str, dict[str, str]]]:
    return {f"{prefix}{i}": ("Part", {"in": f"/{prefix}{i}", "out": f"/{prefix}{(i + 1) % size}"}) for i in range(size)}


PART = work("Part", ["in"], ["out"])


def test_a_chain_rises_upstream_first_and_falls_downstream_first() -> None:
    nodes = {f"n{i}": ("Part", {"in": f"/{i}", "out": f"/{i + 1}"}) for i in (3, 1, 2)}
    spec = system([PART, work("Source", outputs=["out"])], {**nodes, "z": ("Source", {"out": "/1"})})
    configuration, high = structure(spec), initial(spec)
    order = [["z.work"], ["n1.work"], ["n2.work"], ["n3.work"]]
    assert groups(upgrades(configuration, high.modes)) == order
    assert groups(degradations(high, configuration.modes)) == order[::-1]


def test_a_ring_moves_as_one_and_two_rings_as_two() -> None:
    spec = system([PART], {**ring(3), **ring(2, "m")})
    configuration, high = structure(spec), initial(spec)
    assert groups(upgrades(configuration, high.modes)) == [["m0.work", "m1.work"], ["n0.work", "n1.work", "n2.work"]]
    assert [len(group) for group in groups(degradations(high, configuration.modes))] == [3, 2]


def test_a_ring_of_a_thousand_is_still_one_step() -> None:
    spec = system([PART], ring(1000))
    (step,) = upgrades(structure(spec), initial(spec).modes)
    assert len(step.modes) == 1000


def test_of_two_ways_round_the_shorter_one_rises_as_a_group() -> None:
    """a needs b's topic, which d gives as well; d needs a chain of two more. The least group is a with b."""
    nodes = {
        "a": ("Part", {"in": "/help", "out": "/a"}),
        "b": ("Part", {"in": "/a", "out": "/help"}),
        "c": ("Part", {"in": "/a", "out": "/c"}),
        "d": ("Part", {"in": "/c", "out": "/help"}),
    }
    spec = system([PART], nodes)
    assert groups(upgrades(structure(spec), initial(spec).modes)) == [["a.work", "b.work"], ["c.work"], ["d.work"]]


def test_a_mode_on_the_way_spares_the_group() -> None:
    """ping can guarantee /ping at half strength by itself; pong needs no more, and then ping rises fully."""
    between = [Mode("alone", (), Map({"out": SLOW}))]
    ping = component("Ping", functionality("work", ["in"], ["out"], between=between))
    pong = component("Pong", functionality("work", ["in"], ["out"]), needs={"in": SLOW})
    nodes = {"ping": ("Ping", {"in": "/pong", "out": "/ping"}), "pong": ("Pong", {"in": "/ping", "out": "/pong"})}
    spec = system([ping, pong], nodes, topics={"/ping": SLOW})
    configuration, high = structure(spec), initial(spec)
    assert [dict(step.modes) for step in upgrades(configuration, high.modes)] == [
        {at("ping.work"): 1},
        {at("pong.work"): 0},
        {at("ping.work"): 0},
    ]
    assert [dict(step.modes) for step in degradations(high, configuration.modes)] == [
        {at("ping.work"): 1},
        {at("pong.work"): 1},
        {at("ping.work"): 2},
    ]


def test_redundant_support_is_lowered_singly() -> None:
    """f1 and f2 both hold g up, and g holds f2 up: f2, g, f1 goes singly, where f1 first would force a group."""
    nodes = {
        "f1": ("Source", {"out": "/k"}),
        "f2": ("Part", {"in": "/g", "out": "/k"}),
        "g": ("Part", {"in": "/k", "out": "/g"}),
    }
    spec = system([PART, work("Source", outputs=["out"])], nodes)
    high = initial(spec)
    assert groups(degradations(high, structure(spec).modes)) == [["f2.work"], ["g.work"], ["f1.work"]]


def test_what_lost_its_support_goes_in_an_order_in_which_each_step_is_valid() -> None:
    """After a crash the configuration is not valid: downstream first, and rings as one, takes it back."""
    nodes = {
        "source": ("Source", {"out": "/raw"}),
        "a": ("Two", {"in": "/raw", "back": "/b", "out": "/a"}),
        "b": ("Part", {"in": "/a", "out": "/b"}),
        "sink": ("Sink", {"in": "/b"}),
    }
    two = component("Two", functionality("work", ["in", "back"], ["out"]))
    spec = system([PART, two, work("Source", outputs=["out"]), work("Sink", ["in"])], nodes)
    configuration = initial(spec).without_instance("source")
    fallen = lowered(configuration, [at("a.work")])
    steps = degradations(configuration, fallen)
    assert groups(steps) == [["sink.work"], ["a.work", "b.work"]]
    for step in steps:
        configuration = step.apply(configuration)
    assert configuration == best(configuration)


def is_minimal(configuration: Configuration, step: Upgrade) -> bool:
    """Whether no part of a group could have risen by itself, not even part of the way."""
    members = sorted(step.modes)
    for size in range(1, len(members)):
        for some in combinations(members, size):
            if not Upgrade(Map({ref: step.modes[ref] for ref in some})).check(configuration):
                return False
    return True


@given(configurations())
def test_any_two_valid_assignments(configuration: Configuration) -> None:
    """From a drawn valid assignment to ``best`` and back, each step valid, and no group larger than it must be."""
    high = best(configuration)
    raised = upgrades(configuration, high.modes)
    here = configuration
    for up in raised:
        assert is_minimal(here, up)
        here = up.apply(here)
    assert here == high
    for down in degradations(high, configuration.modes):
        here = down.apply(here)
    assert here == configuration


@given(st.dictionaries(st.integers(0, 7), st.lists(st.integers(0, 7), max_size=3), max_size=8))
def test_strongly_connected_components(graph: dict[int, list[int]]) -> None:
    def reach(node: int) -> set[int]:
        seen, pending = {node}, [node]
        while pending:
            for following in graph.get(pending.pop(), []):
                if following in graph and following not in seen:
                    seen.add(following)
                    pending.append(following)
        return seen

    found = strongly_connected(graph)
    assert sorted(node for component in found for node in component) == sorted(graph)
    place = {node: number for number, component in enumerate(found) for node in component}
    for one in graph:
        for other in graph:
            together = other in reach(one) and one in reach(other)
            assert (place[one] == place[other]) == together
            if other in reach(one):
                assert place[other] <= place[one]
