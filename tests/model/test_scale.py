"""Cost follows the change, not the system (docs/semantics.md section 5, F5): evaluations are counted, not time."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
from immutables import Map

from midstride.model import best as best_module
from midstride.model.action import Action, Attach, Create, Degrade, Detach, Handover, Remove, Swap, Upgrade
from midstride.model.best import best, lowered, rebalanced
from midstride.model.component import ComponentSpec, Connector, EnvironmentGuarantee, PortRef, Resource
from midstride.model.configuration import Configuration, Instance
from midstride.model.rules import Evaluator, violations
from midstride.model.specification import Node, Specification, structure
from tests.model.build import at, component, filter_, mode, port, sink, work
from tests.planting import plant

REPORTER = component(
    "Reporter",
    {},
    ["out", "diagnostics"],
    [mode("normal", out=at(10), diagnostics=at(5)), mode("degraded")],
    resource_usage={"cpu": 0.001},
)


def city(streets: int) -> Specification:
    """Streets of five components each, alike and apart, save that all report to one topic and share one resource."""
    connectors = {"/diagnostics": Connector("/diagnostics", at(1))}
    nodes = {"watch": Node("watch", "Watch", Map({"in": ("/diagnostics",)}))}
    for street in range(streets):
        topics = [f"/s{street}/t{number}" for number in range(4)]
        connectors.update((topic, Connector(topic, at(5))) for topic in topics)
        outputs = {"out": (topics[0],), "diagnostics": ("/diagnostics",)}
        nodes[f"s{street}/first"] = Node(f"s{street}/first", "Reporter", Map(outputs))
        for number in range(3):
            wiring = {"in": (topics[number],), "out": (topics[number + 1],)}
            nodes[f"s{street}/f{number}"] = Node(f"s{street}/f{number}", "Filter", Map(wiring))
        nodes[f"s{street}/last"] = Node(f"s{street}/last", "Sink", Map({"in": (topics[3],)}))
    kinds = (REPORTER, filter_(), sink(), sink("Watch", 1))
    return Specification(
        "city",
        connectors=Map(connectors),
        components=Map({kind.name: kind for kind in kinds}),
        nodes=Map(nodes),
        environment=tuple(EnvironmentGuarantee(f"e{n}", at(10), f"/s{n}/t3") for n in range(2, streets)),
        resources=Map({"cpu": Resource("cpu", 0.001 * streets + 1)}),
    )


@contextmanager
def judgements(patch: pytest.MonkeyPatch) -> Iterator[Counter[str]]:
    """How often each kind of judgement is made inside."""
    counted: Counter[str] = Counter()

    def counting(name: str, judge: Callable[..., object]) -> Callable[..., object]:
        def call(*arguments: object, **named: object) -> object:
            counted[name] += 1
            return judge(*arguments, **named)

        return call

    with patch.context() as inside:
        for kind in (Evaluator, best_module.MonotoneEvaluator):
            for name in ("mode_satisfied", "input_satisfied", "connector_satisfied", "guarantee"):
                if name in vars(kind):
                    plant(inside, kind, name, counting(name, vars(kind)[name]))
        yield counted


def first_of(configuration: Configuration) -> PortRef:
    return PortRef("s1/first", "out")


def changes(configuration: Configuration) -> list[tuple[str, Callable[[], object]]]:
    """Every kind of change, each to the street number 1 or to a newcomer."""
    first, topic = first_of(configuration), "/s1/t0"
    cut = configuration.without_attachment(first, topic)
    fallen = cut.with_modes(rebalanced(cut, list(cut.consumers(topic))))
    mended = fallen.with_attachment(first, topic)
    with_new = Create(Instance("new", "new", REPORTER)).apply(configuration).with_modes({work("new"): 0})
    all_down = {work(f"s1/{name}"): 1 for name in ("first", "f0", "f1", "f2", "last")}
    swaps = (
        Swap(topic, first, port("new.out")),
        Swap("/diagnostics", PortRef("s1/first", "diagnostics"), port("new.diagnostics")),
    )
    taken: list[tuple[Configuration, Action]] = [
        (configuration, Create(Instance("new", "new", REPORTER))),
        (with_new, Remove("new")),
        (configuration, Attach(PortRef("s1/last", "in"), "/s2/t0")),
        (configuration, Detach(first, topic)),  # refused
        (configuration, Detach(PortRef("s1/first", "diagnostics"), "/diagnostics")),
        (configuration, Degrade(Map({work("s1/last"): 1}))),
        (configuration, Degrade(Map(all_down))),
        (configuration.with_modes(all_down), Upgrade(Map(dict.fromkeys(all_down, 0)))),
        (with_new, Handover(swaps)),
    ]
    found: list[tuple[str, Callable[[], object]]] = [
        ("rebalanced after a detach", lambda: rebalanced(cut, list(cut.consumers(topic)))),
        ("rebalanced after an attach", lambda: rebalanced(mended, list(mended.consumers(topic)))),
        ("lowered", lambda: lowered(cut, list(cut.consumers(topic)))),
    ]
    for before, action in taken:
        found.append((f"check of {action.kind}", lambda action=action, before=before: action.check(before)))  # type: ignore[misc]
        found.append((f"effect of {action.kind}", lambda action=action, before=before: action.effect(before)))  # type: ignore[misc]
    return found


def test_judgements_do_not_depend_on_the_size_of_the_system(monkeypatch: pytest.MonkeyPatch) -> None:
    counts: list[list[tuple[str, Counter[str]]]] = []
    for streets in (4, 400):
        configuration = best(structure(city(streets)))
        assert not violations(configuration)
        told = []
        for name, change in changes(configuration):
            with judgements(monkeypatch) as counted:
                change()
            told.append((name, counted))
        counts.append(told)
    small, large = counts
    assert sum(sum(counted.values()) for _, counted in small) > 50  # something was judged at all
    for (name, few), (_, many) in zip(small, large, strict=True):
        # Which of a topic's many publishers is asked first is chance; that only one or two are is not.
        slack = Counter(guarantee=2)
        assert all(many[kind] <= few[kind] + slack[kind] for kind in many), (name, few, many)


def test_a_topic_of_many_publishers_is_walked_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """All of them fall, one after another; each reader asks every time."""
    crowd = 300
    lame = component("Lame", {"in": at(5)}, ["out"], [mode("normal", [at(5)], out=at(5)), mode("degraded")])
    kinds: dict[str, ComponentSpec] = {"Lame": lame, "Sink": sink()}
    nodes = {f"n{number}": Node(f"n{number}", "Lame", Map({"out": ("/t",)})) for number in range(crowd)}
    nodes |= {f"r{number}": Node(f"r{number}", "Sink", Map({"in": ("/t",)})) for number in range(crowd)}
    connectors = Map({"/t": Connector("/t", at(5))})
    configuration = structure(Specification("crowd", connectors=connectors, components=Map(kinds), nodes=Map(nodes)))
    with judgements(monkeypatch) as counted:
        fallen = best(configuration)
    assert set(fallen.modes.values()) == {1}
    assert counted["guarantee"] <= 4 * crowd  # not crowd * crowd
    assert counted["mode_satisfied"] <= 6 * crowd


def test_nothing_else_depends_on_the_size_of_the_system() -> None:
    """Every call, of built-in functions too: a change among 2,000 components makes no more of them than among 20."""

    def calls(change: Callable[[], object]) -> int:
        count = 0

        def counting(frame: object, event: str, argument: object) -> None:
            nonlocal count
            count += event in ("call", "c_call")

        change()  # what is made once and kept
        sys.setprofile(counting)
        try:
            change()
        finally:
            sys.setprofile(None)
        return count

    few, many = ({name: calls(change) for name, change in changes(best(structure(city(n))))} for n in (4, 400))
    for name, count in few.items():
        assert many[name] <= 1.1 * count + 20, (name, count, many[name])
