"""What overlaps is safe: every set of done steps that can be reached, beside a slow twin that enumerates them all."""

from __future__ import annotations

import dataclasses
import itertools
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from random import Random

import pytest

from midstride.errors import PlanRefused
from midstride.model.action import Attach, Create, Degrade, Handover, Remove, Upgrade
from midstride.model.component import ComponentSpec, FunctionalityRef
from midstride.model.configuration import Configuration, Instance
from midstride.model.rules import violations
from midstride.model.specification import Specification, initial
from midstride.plan.change_builder import change_between
from midstride.plan.disruption import Levels
from midstride.plan.overlap import CUT, WIDEST, duration, one_by_one, overlap
from midstride.plan.plan import Plan
from midstride.plan.strategies.registry import STRATEGIES, planner
from tests.plan import systems
from tests.plan.cases import changed, sound, system, work

FEW_AND_MANY = pytest.mark.parametrize("seeds", [range(9), pytest.param(range(9, 100), marks=pytest.mark.full)])
# Of plans with more sets of done steps than this, every set would take too long.
MOST = 3_000


def plans(seeds: range, strategies: Sequence[str] = ("minimal", "paper")) -> Iterator[tuple[str, Plan]]:
    """Every third change is tight; every other one is of a system with services."""
    for seed in seeds:
        rng = Random(seed)
        if seed % 3 == 0:
            start, target = systems.tight(rng, rng.randint(2, 3))
        else:
            start, target = systems.change(rng, systems.system(rng, 5, 4), 5)
        if seed % 2:
            start, target = systems.with_services(rng, start, target)
        for strategy in strategies:
            try:
                yield f"seed {seed}, {strategy}", STRATEGIES[strategy](change_between(initial(start), start, target))
            except PlanRefused:
                continue


def held(configuration: Configuration) -> dict[str, float]:
    """How much of each resource is held, and how many publishers each topic has."""
    found: dict[str, float] = {}
    for instance in configuration.instances.values():
        for resource, amount in instance.component.resource_usage.items():
            found[resource] = found.get(resource, 0.0) + float(amount)
    for connector in configuration.context.connectors:
        found[f"publishers of {connector}"] = len(configuration.publishers_on(connector))
    return found


def peak(configurations: Sequence[Configuration]) -> dict[str, float]:
    amounts = [held(each) for each in configurations]
    return {what: max(each.get(what, 0.0) for each in amounts) for what in {key for each in amounts for key in each}}


def sets_of_done_steps(plan: Plan) -> dict[frozenset[int], Configuration] | None:
    """Each that can be reached by taking any step once those it waits for are done; None if there are too many.

    A step whose precondition fails raises; so do two orders that lead to different configurations.
    """
    found = {frozenset[int](): plan.change.start}
    pending = [frozenset[int]()]
    while pending:
        done = pending.pop()
        for index, step in enumerate(plan.steps):
            if index in done or not done.issuperset(plan.dependencies[index]):
                continue
            after, configuration = done | {index}, step.action.apply(found[done])
            if after in found:
                assert found[after] == configuration
            elif len(found) == MOST:
                return None
            else:
                found[after] = configuration
                pending.append(after)
    return found


@FEW_AND_MANY
def test_whatever_is_done_is_valid_and_holds_no_more_than_the_sequence(seeds: range) -> None:
    checked = 0
    for which, plan in plans(seeds):
        found = sets_of_done_steps(plan)
        if found is None:
            continue
        most = peak(tuple(plan.configurations()))
        for configuration in found.values():
            assert violations(configuration) == [], which
        for what, amount in peak(tuple(found.values())).items():
            if not what.startswith("publishers") or _is_capped(plan, what):
                assert amount <= most.get(what, 0.0), f"{which}: {what}"
        checked += len(found) > len(plan.steps) + 1
    assert checked > len(seeds) / 2, "many have steps that commute"


def _is_capped(plan: Plan, what: str) -> bool:
    return plan.change.start.context.connectors[what.removeprefix("publishers of ")].max_publishers is not None


# -- disruption --------------------------------------------------------------------------------------------

# By step: when it begins, and when it ends.
Times = Sequence[tuple[float, float]]


def missing_levels(plan: Plan, times: Times) -> dict[FunctionalityRef, float]:
    """Levels below the baseline x seconds, of each functionality; during a step the worse of before and after counts.

    An action has its effect when its step ends.
    """
    levels, roles, found = Levels(plan.change), [*plan.change.specification.nodes], dict[FunctionalityRef, float]()
    moments = sorted({moment for interval in times for moment in interval})
    in_order = sorted(range(len(times)), key=lambda index: (times[index][1], index))
    for now, then in itertools.pairwise(moments):
        done = [index for index in in_order if times[index][1] <= now]
        configuration = plan.change.start
        for index in done:
            configuration = plan.steps[index].action.apply(configuration)
        below = dict(levels.fallen(configuration, roles))
        for index in in_order:
            if times[index][0] <= now and index not in done:
                after = levels.fallen(plan.steps[index].action.apply(configuration), roles)
                below |= {ref: max(loss, below.get(ref, 0)) for ref, loss in after.items()}
        for ref, loss in below.items():
            found[ref] = found.get(ref, 0.0) + loss * (then - now)
    return found


def in_sequence(seconds: Sequence[float]) -> Times:
    times: list[tuple[float, float]] = []
    for each in seconds:
        begin = times[-1][1] if times else 0.0
        times.append((begin, begin + each))
    return times


def as_early_as_possible(plan: Plan, seconds: Sequence[float]) -> Times:
    times: list[tuple[float, float]] = []
    for waits, each in zip(plan.dependencies, seconds, strict=True):
        begin = max((times[index][1] for index in waits), default=0.0)
        times.append((begin, begin + each))
    return times


def assert_no_worse(which: str, plan: Plan, seconds: Sequence[float]) -> None:
    """Than in the sequence, if every step begins as soon as it may."""
    sequence = missing_levels(plan, in_sequence(seconds))
    for ref, loss in missing_levels(plan, as_early_as_possible(plan, seconds)).items():
        assert loss <= sequence.get(ref, 0.0) + 1e-6, f"{which}: {ref}"


@FEW_AND_MANY
def test_nothing_is_below_its_baseline_for_longer_than_in_the_sequence(seeds: range) -> None:
    """However long the steps take, in whole milliseconds: their sums are exact."""
    shorter = 0
    for which, plan in plans(seeds):
        rng = Random(which)
        seconds = [float(rng.choice((1, 10, 100, 1000, 3000))) for _ in plan.steps]
        assert_no_worse(which, plan, seconds)
        shorter += bool(plan.steps) and max(end for _, end in as_early_as_possible(plan, seconds)) < sum(seconds)
    assert shorter > len(seeds) / 2


@pytest.mark.parametrize(
    ("seed", "strategy", "because"),
    [
        (5, "minimal", "the replaced role would be without an instance"),
        (19, "minimal", "the output would be on no topic while it moves"),
        (35, "paper", "a detach that the fall need not wait for would delay what ends it"),
    ],
)
def test_what_would_be_valid_and_disrupt_more_keeps_its_order(seed: int, strategy: str, because: str) -> None:
    [(which, plan)] = plans(range(seed, seed + 1), [strategy])
    assert_no_worse(f"{which}: {because}", plan, [round(1000 * step.seconds) for step in plan.steps])


# -- what the executor overlaps ----------------------------------------------------------------------------


@FEW_AND_MANY
def test_rounds_are_the_steps_in_order_and_start_no_process_too_early(seeds: range) -> None:
    several: Counter[str] = Counter()
    ahead = 0
    for which, plan in plans(seeds, sorted(STRATEGIES)):
        found, configurations = overlap(plan), list(plan.configurations())
        assert [index for some in found.rounds for index in some] == list(range(len(plan.steps)))
        for some in found.rounds:
            actions = [plan.steps[index].action for index in some]
            if len(some) > 1:
                several[type(actions[0]).__name__] += 1
                kinds: tuple[set[type], ...] = ({Remove}, {Attach}, {Degrade, Upgrade}, {Handover})
                assert any({*map(type, actions)} <= kind for kind in kinds)
            assert not {waits for index in some for waits in plan.dependencies[index]} & set(some)
        created = [index for index, step in enumerate(plan.steps) if isinstance(step.action, Create)]
        assert sorted(index for starts in found.starts.values() for index in starts) == created
        most = peak(configurations)
        for done, configuration in enumerate(configurations):
            for number, starts in found.starts.items():
                for index in starts:
                    if number <= done <= index:
                        configuration = plan.steps[index].action.apply(configuration)
                        ahead += done < index
            assert violations(configuration) == [], which
            assert all(amount <= most[what] for what, amount in held(configuration).items())
    assert min(several[kind.__name__] for kind in (Remove, Attach, Upgrade)) > len(seeds) / 10, several
    assert ahead > len(seeds)


def test_processes_start_beside_each_other_also_where_other_steps_are_between_their_creations() -> None:
    parts = [work(name, outputs=["out"]) for name in ("A", "B", "A2", "B2")]
    start = system(parts, {"a": ("A", {"out": "/x"}), "b": ("B", {"out": "/y"})})
    target = system(parts, {"a": ("A2", {"out": "/x"}), "b": ("B2", {"out": "/y"})})
    plan = sound(changed(start, target, "paper"))
    kinds = [step.action.kind for step in plan.steps]
    first, second = (index for index, kind in enumerate(kinds) if kind == "create")
    assert "attach" in kinds[first:second]
    removed = [index for index, kind in enumerate(kinds) if kind == "remove"]
    assert overlap(plan).starts == {removed[0] + 1: [first], removed[1] + 1: [second]}


@FEW_AND_MANY
def test_a_plan_takes_between_its_critical_path_and_the_sum_of_its_steps(seeds: range) -> None:
    shorter = 0
    for which, plan in plans(seeds):
        taken = duration(plan).seconds
        assert plan.makespan - 1e-6 <= taken <= plan.seconds + 1e-6, which
        shorter += taken < plan.seconds - 1e-6
    assert shorter > len(seeds) / 2


def test_how_long_a_plan_takes_follows_from_what_overlaps() -> None:
    """Both processes load at once, the longer one for as long as its longest; both old ones are removed at once."""
    parts = [work(name, outputs=["out"]) for name in ("A", "B", "A2", "B2")]
    start = system(parts, {"a": ("A", {"out": "/x"}), "b": ("B", {"out": "/y"})})
    target = system(parts, {"a": ("A2", {"out": "/x"}), "b": ("B2", {"out": "/y"})})
    plan = sound(changed(start, target, "minimal"))
    kinds = [step.action.kind for step in plan.steps]
    assert kinds[:2] == ["create", "create"] and kinds[-2:] == ["remove", "remove"]
    assert [type(step.action) for step in plan.steps[2:-2]] == [Upgrade, Upgrade, Handover, Handover]
    others = plan.steps[2].seconds + sum(step.seconds for step in plan.steps[4:-2])
    seconds: dict[int, tuple[float, tuple[float, float] | None]] = {
        0: (1.0, (0.5, 1.5)),
        1: (2.0, (1.0, 9.0)),
        len(plan.steps) - 2: (0.25, None),
        len(plan.steps) - 1: (0.75, (0.5, 0.75)),
    }
    steps = list(plan.steps)
    for index, (expected, between) in seconds.items():
        steps[index] = dataclasses.replace(steps[index], seconds=expected, between=between)
    found = duration(dataclasses.replace(plan, steps=tuple(steps)))
    assert found.seconds == pytest.approx(2.0 + others + 0.75)
    assert found.between == pytest.approx((1.0 + others + 0.5, 9.0 + others + 0.75))


def in_rounds(plan: Plan, seconds: Sequence[float]) -> Times:
    """As the executor takes them: the hand-overs of a round are cut one after another once all are ready."""
    times: dict[int, tuple[float, float]] = {}
    now = 0.0
    for some in overlap(plan).rounds:
        ends = {index: now + seconds[index] for index in some}
        if isinstance(plan.steps[some[0]].action, Handover):
            at = max(ends.values()) - CUT
            for index in some:
                ends[index] = at = at + CUT
        times |= {index: (now, end) for index, end in ends.items()}
        now = max(ends.values())
    return [times[index] for index in range(len(plan.steps))]


@FEW_AND_MANY
def test_in_rounds_nothing_is_below_its_baseline_for_longer_than_in_the_sequence(seeds: range) -> None:
    """Whatever of the steps is long; a hand-over takes at least as long as its cut."""
    shorter = 0
    for which, plan in plans(seeds, sorted(STRATEGIES)):
        rng = Random(which)
        seconds = [
            rng.choice((1.0, 10.0, 100.0, 3000.0)) + CUT * isinstance(step.action, Handover) for step in plan.steps
        ]
        sequence, rounds = in_sequence(seconds), in_rounds(plan, seconds)
        # A hand-over may end later than in the sequence, since all are ready before the first cut; its round does not.
        for some in overlap(plan).rounds:
            assert ends(rounds)[some[-1]] <= ends(sequence)[some[-1]] + 1e-6
        before = missing_levels(plan, sequence)
        for ref, loss in missing_levels(plan, rounds).items():
            assert loss <= before.get(ref, 0.0) + 1e-6, f"{which}: {ref}"
        shorter += bool(rounds) and ends(rounds)[-1] < ends(sequence)[-1]
    assert shorter > len(seeds) / 3


def ends(times: Times) -> list[float]:
    """Of each step, when all up to it have ended."""
    return [max(end for _, end in times[: index + 1]) for index in range(len(times))]


def rounds_of(start: Specification, target: Specification) -> list[list[str]]:
    """The steps of each round with several, in words."""
    plan = sound(changed(start, target, "minimal"))
    return [[plan.steps[index].describe() for index in some] for some in overlap(plan).rounds if len(some) > 1]


def test_independent_replacements_are_taken_kind_by_kind() -> None:
    parts = [work(name, outputs=["out"]) for name in ("A", "B", "A2", "B2")]
    start = system(parts, {"a": ("A", {"out": "/x"}), "b": ("B", {"out": "/y"})})
    target = system(parts, {"a": ("A2", {"out": "/x"}), "b": ("B2", {"out": "/y"})})
    assert rounds_of(start, target) == [
        ["upgrade a_2.work from degraded to normal", "upgrade b_2.work from degraded to normal"],
        ["hand over /x from a.out to a_2.out", "hand over /y from b.out to b_2.out"],
        ["remove a", "remove b"],
    ]


def test_attachments_are_taken_at_once_unless_one_has_to_find_the_other() -> None:
    """An attachment is done when it has found those at the other end of its topic."""
    parts = [work("Head", outputs=["out"]), work("Link", inputs=["in"], outputs=["out"]), work("Tail", inputs=["in"])]
    nodes: dict[str, tuple[str, dict[str, str]]] = {"a": ("Head", {"out": "/x"}), "e": ("Tail", {"in": "/y"})}
    nodes |= {name: ("Link", {"in": "/x", "out": f"/{name}"}) for name in ("b", "c")} | {
        "d": ("Link", {"in": "/b", "out": "/y"})
    }
    assert rounds_of(system(parts, {}), system(parts, nodes))[:2] == [
        ["attach a.out to /x", "attach b.out to /b", "attach c.out to /c", "attach d.out to /y"],
        ["attach b.in to /x", "attach c.in to /x", "attach d.in to /b", "attach e.in to /y"],
    ]


def test_what_hears_a_topic_is_not_handed_over_beside_its_publisher_but_may_be_before_it() -> None:
    """Its new side would be on probation with what the old publisher writes. The order is that of the names."""
    parts = [work(name, outputs=["out"]) for name in ("A", "A2")]
    parts += [work(name, inputs=["in"], outputs=["out"]) for name in ("B", "B2")]

    def of(first: str, second: str, generation: str) -> Specification:
        nodes = {first: (f"A{generation}", {"out": "/x"}), second: (f"B{generation}", {"in": "/x", "out": "/y"})}
        return system(parts, nodes)

    handed = "hand over /x from a.out to a_2.out", "hand over /y from z.out to z_2.out"
    assert not any(set(handed) & set(some) for some in rounds_of(of("a", "z", ""), of("a", "z", "2")))
    reverse = "hand over /y from a.out to a_2.out", "hand over /x from z.out to z_2.out"
    assert list(reverse) in rounds_of(of("z", "a", ""), of("z", "a", "2"))


def test_publishers_of_one_topic_are_not_handed_over_at_once() -> None:
    """Each of the two new ones would be counted for the other."""
    parts = [work(name, outputs=["out"]) for name in ("A", "A2")]
    start, target = (system(parts, {role: (name, {"out": "/x"}) for role in "ab"}) for name in ("A", "A2"))
    assert not any("hand over" in words for some in rounds_of(start, target) for words in some)


def test_a_round_of_commands_is_of_so_many_components_at_most() -> None:
    parts = [work(name, outputs=["out"]) for name in ("A", "A2")]
    roles = [f"n{number:03}" for number in range(2 * WIDEST + 2)]
    start, target = (system(parts, {role: (name, {"out": f"/{role}"}) for role in roles}) for name in ("A", "A2"))
    plan = sound(changed(start, target, "minimal"))
    sizes: dict[type, list[int]] = defaultdict(list)
    for some in overlap(plan).rounds:
        sizes[type(plan.steps[some[0]].action)].append(len(some))
    assert sizes[Upgrade] == sizes[Handover] == [WIDEST, WIDEST, 2]
    assert sizes[Remove] == [len(roles)], "a process ends without being asked for more than that"


def test_one_by_one_only_processes_of_creations_in_a_row_start_at_once() -> None:
    create, other = Create(Instance("b", "b", work("A"))), Remove("a")
    found = one_by_one([other, create, create, other, create])
    assert found.rounds == ((0,), (1,), (2,), (3,), (4,))
    assert found.starts == {1: [1, 2], 4: [4]}
    once = Create(Instance("c", "c", ComponentSpec("C", run="c", gate="none", once=True)))
    assert one_by_one([create, once, create]).starts == {0: [0, 2]}, "a program that ends is started in its own step"


@pytest.mark.parametrize(
    "seeds",
    [
        pytest.param(range(0, 32, 2), id="few", marks=pytest.mark.full),
        pytest.param(range(32, 200, 2), id="many", marks=pytest.mark.long),
    ],
)
def test_plans_with_detours_overlap_as_safely(seeds: range) -> None:
    """A stand-in is an instance of a role beside another one, and leaves again."""
    checked = 0
    for seed in seeds:
        rng = Random(seed)
        start, target = systems.tight(rng, rng.randint(2, 3))
        try:
            plan = planner("minimal", detours=True)(change_between(initial(start), start, target))
        except PlanRefused:
            continue
        if plan.change.detours:
            for configuration in (sets_of_done_steps(plan) or {}).values():
                assert violations(configuration) == [], seed
            assert_no_worse(f"seed {seed}", plan, [round(1000 * step.seconds) for step in plan.steps])
            checked += 1
    assert checked > len(seeds) / 8
