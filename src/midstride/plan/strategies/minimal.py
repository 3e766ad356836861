"""Strategy ``minimal``: make before break, hand over, and break before make only where it is forced.

The conflict core is searched for the least disruption there is (:mod:`..core.core_plan`). Of the plans that
have it, several ways through the core are tried and the best is kept, by number of functionalities that fall, makespan
and number of steps (docs/semantics.md section 6).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import inf
from typing import Final

from midstride.errors import PlanRefused
from midstride.model.component import FunctionalityRef
from midstride.model.contract import format_number
from midstride.model.specification import Constraint, Order, roles_of
from midstride.model.wording import KIND_WORDS
from midstride.plan.change import Change
from midstride.plan.constraints import Breach, ConstraintMonitor, breaches, conflict, in_force, refusal
from midstride.plan.core.conflict_core import full_topics, scarce_resources
from midstride.plan.core.core_plan import Budget, CoreResult, plans_along, search_core
from midstride.plan.core.moves import moves, play
from midstride.plan.core.search_state import SearchState
from midstride.plan.disruption import Levels
from midstride.plan.plan import Plan
from midstride.plan.schedule import makespan
from midstride.plan.step import Step
from midstride.plan.strategies.plan_builder import Ceiling, PlanBuilder

# How many moves are tried in all; after that only the first few of each choice, and only one is followed.
_TRIALS: Final = 600
_FEW: Final = 6
# Where a plan is known and more actions than these are tied, only the first few of each choice are tried at all.
_MANY: Final = 24

Key = tuple[bool, float, int, float, int]


@dataclass(frozen=True, slots=True)
class Candidate:
    """A whole plan and its rank: breaches, disruption, functionalities fallen, makespan, steps."""

    key: Key
    steps: tuple[Step, ...]
    breaches: tuple[Breach, ...]

    @property
    def disruption(self) -> float:
        return self.key[1]

    @property
    def makespan(self) -> float:
        return self.key[3]

    @property
    def is_free(self) -> bool:
        """Return whether nothing is lost, nothing falls and no constraint is broken."""
        return self.key[:3] == (False, 0.0, 0)


def minimal(change: Change, budget: Budget | None = None) -> Plan:
    """The best plan found, with the lower bound proved within ``budget`` (None: in a fixed number of states).

    An interrupt (Ctrl-C) ends the search for the proof, and keeps what was found. Raises PlanRefused, with the
    constraints in conflict, where no plan was found that meets all of them.
    """
    levels = Levels(change)
    constraints = in_force(change)
    found, core = _best(levels, constraints, budget or Budget())
    if found is None or found.breaches:
        broken = () if found is None else found.breaches
        relevant = _relevant(change, found, constraints)

        def can_meet(some: tuple[Constraint, ...]) -> bool:
            trial, _ = _best(levels, some, Budget())
            return trial is not None and not trial.breaches

        if can_meet(()):
            conflicting = conflict(relevant, can_meet)
            raise refusal(conflicting, broken, _limits(levels, conflicting))
        raise PlanRefused("no order of the steps was found that respects all caps and capacities")
    return Plan.of("minimal", found.steps, levels, core.lower_bound, found.makespan, core.certificate)


def _best(levels: Levels, constraints: Sequence[Constraint], budget: Budget) -> tuple[Candidate | None, CoreResult]:
    """The best plan found, and what is known of the conflict core: a lower bound on the disruption of any."""
    core = search_core(levels, constraints, budget)
    along = cheapest_along(core, levels, constraints)
    if levels.change.detours:  # the search by moves knows no instance that comes and goes
        return along, core
    return _find(levels, constraints, along, few=sum(map(len, core.moves or ())) > _MANY), core


def _limits(levels: Levels, constraints: Sequence[Constraint]) -> list[str]:
    """The caps and capacities that ``constraints`` conflict with: a smallest set, where it is proved that they do."""
    change = levels.change
    limits = (*scarce_resources(change), *full_topics(change))

    def is_possible(some: Sequence[str]) -> bool:
        ignored = [limit for limit in limits if limit not in some]
        return search_core(levels, constraints, Budget(), ignored).lower_bound < inf

    if is_possible(limits):
        named: Sequence[str] = scarce_resources(change)
    else:
        named = conflict(limits, is_possible) if is_possible(()) else ()
    return [*_no_room(change, named), *_no_slots(change, named)]


def cheapest_along(core: CoreResult, levels: Levels, constraints: Sequence[Constraint]) -> Candidate | None:
    """The best plan along the core's moves, with hand-overs unless these lose more."""
    if not core.moves:
        return None
    orders = [constraint for constraint in constraints if isinstance(constraint, Order)]
    state = SearchState.at_start(PlanBuilder.at_start(levels), orders)
    candidates = (_candidate(levels, constraints, builder) for builder in plans_along(state, core.moves))
    # The first of those that lose as little: without a hand-over, old and new are heard at once, however quick it is.
    return min(candidates, key=lambda candidate: candidate.key[:3], default=None)


def _no_room(change: Change, resources: Sequence[str]) -> Iterator[str]:
    """The resources too scarce for everything new to be created before anything is removed."""
    configuration = change.start
    for resource in sorted(set(resources).intersection(scarce_resources(change))):
        names = [name for name in change.leaving if resource in configuration.instances[name].resource_usage]
        names += [instance.name for instance in change.coming if resource in instance.resource_usage]
        capacity = format_number(configuration.context.capacity(resource))
        yield f"{' and '.join(names)} do not fit at the same time: {resource} has a capacity of {capacity}"


def _no_slots(change: Change, topics: Sequence[str]) -> Iterator[str]:
    """The topics on which the new outputs do not fit beside the old ones."""
    for name in sorted(set(topics).intersection(full_topics(change))):
        connector, old = change.start.context.connectors[name], (name, change.sibling(name))
        leave = " and ".join(str(port) for port, on in change.detached if on in old and change.is_output(port))
        come = " and ".join(str(port) for port, on in change.attached if on == name and change.is_output(port))
        cap = f"has a cap of {connector.max_publishers}"
        if connector.kind != "topic":
            cap = f"has at most one {KIND_WORDS[connector.kind].provider}"
        yield f"{come} and {leave} do not fit at the same time: {connector.topic} {cap}"


def _relevant(change: Change, found: Candidate | None, constraints: Iterable[Constraint]) -> list[Constraint]:
    """The constraints that concern the roles that the plan touches; all, where there is none."""
    if found is None:
        return list(constraints)
    touched = {change.role_of(name) for name in change.instances()}
    touched.update(role for step in found.steps for role in step.roles)
    return [constraint for constraint in constraints if touched.intersection(roles_of(constraint))]


def _find(
    levels: Levels, constraints: Sequence[Constraint], known: Candidate | None = None, *, few: bool = False
) -> Candidate | None:
    """The best plan found under ``constraints``, perhaps one that breaks some; None where the orders leave none.

    A plan that is no better than the one ``known`` already is found only where it is as good.
    """
    most = inf if known is None or known.breaches else known.key[1]
    # Raising a functionality above its modes at both ends costs steps, and helps others only in a conflict.
    few = few and most < inf
    found = _search(levels, constraints, _no_higher_than_the_ends(levels.change), None, most, few=few)
    if found is None or not found.is_free:
        found = _search(levels, constraints, None, found, most, few=few)
        if (found is None or not found.is_free) and _shares_a_capped_topic(levels.change):
            found = _search(levels, constraints, None, found, most, few=few, eager=False)
    return known if found is None or (known is not None and known.key < found.key) else found


def _shares_a_capped_topic(change: Change) -> bool:
    """Return whether several outputs come to one capped topic, so that a slot may be better given to another output."""
    connectors = change.start.context.connectors
    coming = Counter(
        connector
        for port, connector in change.attached
        if connectors[connector].max_publishers is not None and change.is_output(port)
    )
    return any(count > 1 for count in coming.values())


def _no_higher_than_the_ends(change: Change) -> Ceiling:
    start, final = change.start.modes, change.final.modes

    def ceiling(ref: FunctionalityRef) -> int:
        return min(modes[ref] for modes in (start, final) if ref in modes)

    return ceiling


def _search(
    levels: Levels,
    constraints: Sequence[Constraint],
    ceiling: Ceiling | None,
    best: Candidate | None,
    most: float,
    *,
    few: bool,
    eager: bool = True,
) -> Candidate | None:
    """Depth first through the conflict core, cheapest first, within the number of trials.

    ``best`` is the best plan found before; it is returned where no better one is found. Only plans with at most the
    disruption ``most`` are of interest.
    """
    orders = [constraint for constraint in constraints if isinstance(constraint, Order)]
    monitor = ConstraintMonitor.of(levels, constraints) if constraints else None
    start = SearchState.at_start(PlanBuilder.at_start(levels, ceiling, monitor), orders, eager=eager)
    if start.layers() is None:
        return best
    trials = _TRIALS // 10 if few else _TRIALS
    stack = [start.advance()]
    while stack:
        state = stack.pop()
        doomed, meter = state.builder.is_doomed, state.builder.meter
        if meter.disruption > most:
            continue
        if (best is not None or most < inf) and (trials <= 0 or doomed):
            continue
        if best is not None and not best.breaches and (meter.disruption, len(meter.fallen)) > best.key[1:3]:
            continue
        if state.only_removals_left:
            found = _candidate(levels, constraints, state.finish())
            if best is None or found.key < best.key:
                best = found
            if best.is_free:
                break
            continue
        # A doomed state is followed to its end only while there is no other plan to report, and in one way only.
        tried = moves(state)[: 1 if doomed else _FEW if few or trials <= 0 else None]
        following = sorted((play(state, move).advance() for move in tried), key=_priority)
        trials -= len(tried)
        stack.extend(following[: None if trials > 0 else 1][::-1])
    return best


def _priority(state: SearchState) -> tuple[bool, float, float, int]:
    """The rank of a state: is it doomed, and what will it have cost, roughly, once everything that fell is restored?"""
    change, meter = state.builder.change, state.builder.meter
    roles = {ref.instance for ref in meter.below}
    awaited = [change.seconds("create", i) for i in state.creates.values() if i.role in roles]
    cost = meter.disruption + meter.missing * max(awaited, default=0.0)
    return state.builder.is_doomed, cost, meter.missing, len(state.builder.numbered)


def _candidate(levels: Levels, constraints: Sequence[Constraint], builder: PlanBuilder) -> Candidate:
    steps, meter = builder.steps, builder.meter
    broken = tuple(breaches(steps, levels, constraints))
    key = (bool(broken), meter.disruption, len(meter.fallen), makespan(steps, levels), len(steps))
    return Candidate(key, steps, broken)
