"""The steps of a plan that overlap when it is carried out (docs/semantics.md section 6).

The steps keep the order of the plan. What overlaps: a process starts as soon as everything is done that its ``create``
step must wait for; and steps next to each other are carried out at once, in a round, if they are all removals, all
attachments, all mode changes, all settings of parameters, all hand-overs or all programs that end, which do not start
before their step. The hand-overs of a round are prepared and watched at once, and their cuts follow one another. How
long the plan takes follows from that.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from midstride.model.action import Action, Attach, Create, Degrade, Handover, Remove, SetParameters, Upgrade
from midstride.plan.disruption import DIGITS
from midstride.plan.estimate import Estimate
from midstride.plan.plan import Plan
from midstride.plan.state_continuity import without_outputs

# How many components answer commands at once, on however small a machine: of attachments, mode changes and hand-overs,
# so many steps are carried out at once.
WIDEST: Final = 16
# How much of a hand-over its cut is (s): the moment is agreed 0.1 s ahead, and both sides report a few periods later.
CUT: Final = 0.3


@dataclass(frozen=True, slots=True)
class Overlap:
    """The ``rounds`` of a plan: its steps in order, those of one round are carried out at once.

    ``starts``: by number of steps, the creations whose processes may start as soon as that many are done.
    """

    rounds: tuple[tuple[int, ...], ...]
    starts: dict[int, list[int]]


def one_by_one(actions: Sequence[Action]) -> Overlap:
    """One step after another; only the processes of creations next to each other start at once."""
    starts: dict[int, list[int]] = {}
    first = 0
    for index, action in enumerate(actions):
        if not isinstance(action, Create):
            first = index + 1
        elif not action.instance.component.once:
            starts.setdefault(first, []).append(index)
    return Overlap(tuple((index,) for index in range(len(actions))), starts)


def overlap(plan: Plan) -> Overlap:
    """Find the steps that overlap, by the plan's dependencies: whatever steps are done at a time, the configuration
    is valid.
    """
    neighbours = _Neighbours(plan)
    rounds: list[tuple[int, ...]] = []
    starts: dict[int, list[int]] = {}
    for index, (step, waits) in enumerate(zip(plan.steps, plan.dependencies, strict=True)):
        last = rounds[-1] if rounds else ()
        if last and not set(last).intersection(waits) and neighbours.admit(last, index):
            rounds[-1] = (*last, index)
        else:
            rounds.append((index,))
        if isinstance(step.action, Create) and not step.action.instance.component.once:
            starts.setdefault(max(waits, default=-1) + 1, []).append(index)
    return Overlap(tuple(rounds), starts)


def duration(plan: Plan) -> Estimate:
    """The duration of the plan as it is carried out (s), between the critical path and the sum of its steps.

    The shortest and the longest are those with every step at its shortest and at its longest. It is assumed that
    processes do not slow each other down while they start.
    """
    found = overlap(plan)
    between = [step.between or (step.seconds, step.seconds) for step in plan.steps]
    expected = [step.seconds for step in plan.steps]
    shortest, longest = ([each[end] for each in between] for end in (0, 1))
    return Estimate(*(round(_last_end(plan, found, seconds), DIGITS) for seconds in (expected, shortest, longest)))


def _last_end(plan: Plan, found: Overlap, seconds: Sequence[float]) -> float:
    """The end of the last round, if the steps take so long; the process of a creation may have begun before it."""
    now, looked = 0.0, 0
    started: dict[int, float] = {}
    for some in found.rounds:
        for number in range(looked, some[0] + 1):
            started.update(dict.fromkeys(found.starts.get(number, ()), now))
        looked = some[0] + 1
        if isinstance(plan.steps[some[0]].action, Handover):
            cuts = [min(CUT, seconds[index]) for index in some]
            now += sum(cuts) + max(seconds[index] - cut for index, cut in zip(some, cuts, strict=True))
        else:
            now = max(now, *(started.get(index, now) + seconds[index] for index in some))
    return now


class _Neighbours:
    """The steps of a plan that may be in one round, where none waits for another."""

    def __init__(self, plan: Plan) -> None:
        self._plan, self._change = plan, plan.change
        # Between two instances without outputs, state moves beside a step of either (runtime/handover/state_moves.py).
        replaced = without_outputs(plan.change)
        self._partners = {**replaced, **{old: new for new, old in replaced.items()}}
        self._attached: dict[str, set[str]] = defaultdict(set)  # by instance: the connectors that it is attached to
        for port, connector in plan.change.attached:
            self._attached[port.instance].add(connector)

    def admit(self, earlier: Sequence[int], index: int) -> bool:
        """Return whether a step may be in the round of those ``earlier`` ones."""
        kind = self._kind(index)
        if kind is None or any(self._kind(each) != kind for each in earlier):
            return False
        if kind in ("removals", "programs"):
            return True
        # A component refuses the second of two changes at one revision.
        commanded = self._commanded(index)
        if len(earlier) >= WIDEST or any(commanded & self._commanded(each) for each in earlier):
            return False
        if kind == "attachments":
            return not self._waits_for_peer(earlier, index)
        return kind in ("mode changes", "settings") or self._is_independent(earlier, index)

    def _kind(self, index: int) -> str | None:
        """The kind of the rounds that a step may be in; None if it is always alone."""
        shifts = self._plan.schedule.shifts[index]
        match self._plan.steps[index].action:
            case Remove():
                return "removals"
            case Create(instance) if instance.component.once:
                return "programs"
            case Attach() if not shifts:
                return "attachments"
            case Upgrade():
                return "mode changes"
            case Degrade() if not any(shift.after > shift.before for shift in shifts):
                return "mode changes"  # else what falls would have fallen for as long as the slowest beside it takes
            case SetParameters():
                return "settings"
            case Handover() if not shifts:
                return "handovers"  # else what rises by it would wait for the slowest beside it
        return None

    def _commanded(self, index: int) -> set[str]:
        names = self._plan.steps[index].action.instances()
        return {*names, *(self._partners[name] for name in names if name in self._partners)}

    def _waits_for_peer(self, earlier: Sequence[int], index: int) -> bool:
        """Return whether an attachment has to find what one of ``earlier`` attaches, at the other end of its topic."""
        ends = [
            (self._change.start.topic(action.connector), self._change.is_output(action.port))
            for each in (*earlier, index)
            if isinstance(action := self._plan.steps[each].action, Attach)
        ]
        topic, output = ends.pop()
        return (topic, not output) in ends

    def _is_independent(self, earlier: Sequence[int], index: int) -> bool:
        """Return whether the two sides of a hand-over write and hear nothing that ``earlier`` ones hand over.

        On a topic that they shared, new publishers would be counted for each other's. What a new side hears is to be,
        during its probation, what it hears after its cut.
        """
        topic = self._change.start.topic
        exchanged = {
            topic(swap.connector)
            for each in earlier
            if isinstance(action := self._plan.steps[each].action, Handover)
            for swap in action.swaps
        }
        own = self._plan.steps[index].action.instances()
        return not any(topic(connector) in exchanged for name in own for connector in self._connectors(name))

    def _connectors(self, instance: str) -> set[str]:
        """The connectors that an instance is attached to at some time during the plan."""
        live = instance in self._change.start.instances
        before = self._change.start.attached_ports(instance) if live else ()
        return {*self._attached[instance], *(connector for _, connector in before)}
