"""The steps of a plan that commute, and the time that it takes when those that do overlap.

Each step leaves *marks*: what it does to an instance, an attachment, a mode, a functionality's support, a cap or a
capacity. Two steps commute unless two of their marks clash. The table relies on monotonicity (docs/semantics.md
section 5, F2 and F3): support that arrives earlier, or is withdrawn later, does no harm. So every order that preserves
the order of clashing pairs is valid, step by step.

Two more kinds of steps keep their order, although validity alone does not require it: those that determine the level of
a role with several instances or with outputs that move, and a step by which a functionality falls below its baseline,
which waits for every earlier step. So nothing is below its baseline for longer than in the sequence: between the fall
and the step that ends it, there is nothing to wait for but what the sequence has between them.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from itertools import islice
from typing import Final

from midstride.model.action import Attach, Create, Degrade, Detach, Handover, Remove, SetParameters, Upgrade
from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.specification import Order
from midstride.plan.change import Change, PortAttachment
from midstride.plan.constraints import in_force
from midstride.plan.disruption import DIGITS, LevelChange, Levels, follow
from midstride.plan.step import Step


class Access(Enum):
    """The access of a step to the thing that it marks."""

    OWN = auto()
    USE = auto()
    SUPPORT = auto()
    DEPEND = auto()
    WITHDRAW = auto()
    RELEASE = auto()
    ACQUIRE = auto()
    BEFORE = auto()
    AFTER = auto()

    # By identity: the hash that Enum defines in Python is a tenth of a plan's time.
    __hash__ = object.__hash__


# A step with the second access to a thing waits for each earlier step with one of the first to it.
_WAITS_FOR: Final[dict[Access, tuple[Access, ...]]] = {
    Access.OWN: (Access.OWN, Access.USE),
    Access.USE: (Access.OWN,),
    Access.DEPEND: (Access.SUPPORT,),
    Access.WITHDRAW: (Access.SUPPORT, Access.DEPEND),
    Access.ACQUIRE: (Access.RELEASE,),
    Access.AFTER: (Access.BEFORE,),
}

Mark = tuple[Hashable, Access]


class _Marker:
    def __init__(self, change: Change) -> None:
        self.change = change
        # The roles whose level depends on the order of their steps: those of several instances, or with moving outputs.
        self.moving = {each.role for each in change.coming if each.role in change.start.instances_by_role}
        self.moving |= self._roles_of_outputs(change.detached) & self._roles_of_outputs(change.attached)
        self.orders = [constraint for constraint in in_force(change) if isinstance(constraint, Order)]
        self._attached: dict[PortRef, list[str]] = defaultdict(list)
        self._inputs: dict[str, list[PortRef]] = defaultdict(list)
        for port, connector in change.attached:
            self._attached[port].append(connector)
            if port.port in change.component_of(port.instance).inputs:
                self._inputs[connector].append(port)
        self._consumers: dict[str, list[FunctionalityRef]] = {}

    def _roles_of_outputs(self, attachments: Iterable[PortAttachment]) -> set[str]:
        return {self.change.role_of(port.instance) for port, _ in attachments if self.change.is_output(port)}

    def of(self, step: Step) -> Iterator[Mark]:
        action = step.action
        if step.is_structural:
            for order in self.orders:
                if order.first in step.roles:
                    yield ("order", order), Access.BEFORE
                if order.then in step.roles:
                    yield ("order", order), Access.AFTER
        match action:
            case Create():
                yield ("live", action.instance.name), Access.OWN
                yield from self._role(action.instance.role)
                for resource in action.instance.resource_usage:
                    yield ("resource", resource), Access.ACQUIRE
            case Remove():
                yield ("live", action.instance), Access.OWN
                yield from self._role(self.change.role_of(action.instance))
                for resource in self.change.instance(action.instance).resource_usage:
                    yield ("resource", resource), Access.RELEASE
            case Attach():
                yield from self._attachment(action.port, action.connector, Access.SUPPORT)
                yield from self._slot(action.port, action.connector, Access.ACQUIRE)
            case Detach():
                yield from self._attachment(action.port, action.connector, Access.WITHDRAW)
                yield from self._slot(action.port, action.connector, Access.RELEASE)
            case Handover():
                for swap in action.swaps:
                    for port in (swap.old, swap.new):
                        yield from self._attachment(port, swap.connector, Access.SUPPORT)
                    owner = self.change.component_of(swap.new.instance).owner(swap.new.port)
                    yield ("mode", FunctionalityRef(swap.new.instance, owner.name)), Access.USE
            case Degrade() | Upgrade():
                for ref in action.modes:
                    yield from self._mode(ref, isinstance(action, Upgrade))
            case SetParameters():
                yield ("live", action.instance), Access.USE
                yield ("parameters", action.instance), Access.OWN

    def _role(self, role: str) -> Iterator[Mark]:
        if role in self.moving:
            yield ("role", role), Access.OWN

    def _attachment(self, port: PortRef, connector: str, access: Access) -> Iterator[Mark]:
        yield ("live", port.instance), Access.USE
        yield ("attachment", port, connector), Access.OWN
        component = self.change.component_of(port.instance)
        if port.port in component.inputs:
            for functionality in component.users(port.port):
                yield ("support", FunctionalityRef(port.instance, functionality.name)), access
        else:
            yield from self._role(self.change.role_of(port.instance))
            for ref in self._consumers_of(connector):
                yield ("support", ref), access

    def _slot(self, port: PortRef, connector: str, access: Access) -> Iterator[Mark]:
        connectors = self.change.start.context.connectors
        topic = connectors[connector].topic
        capped = any(
            connectors[name].max_publishers is not None
            for name in (connector, self.change.identities.get(topic, topic))
        )
        if capped and self.change.is_output(port):
            yield ("topic", topic), access

    def _mode(self, ref: FunctionalityRef, better: bool) -> Iterator[Mark]:
        yield ("live", ref.instance), Access.USE
        yield ("mode", ref), Access.OWN
        yield ("support", ref), Access.DEPEND
        yield from self._role(self.change.role_of(ref.instance))
        access = Access.SUPPORT if better else Access.WITHDRAW
        for output in self.change.component_of(ref.instance).functionalities[ref.functionality].outputs:
            port = PortRef(ref.instance, output)
            for connector in {*self.change.start.connectors_of.get(port, ()), *self._attached.get(port, ())}:
                for consumer in self._consumers_of(connector):
                    if consumer != ref:
                        yield ("support", consumer), access

    def _consumers_of(self, connector: str) -> Iterable[FunctionalityRef]:
        """The functionalities that use an input attached to ``connector`` at some time during the plan."""
        if connector not in self._consumers:
            found = dict.fromkeys(self.change.start.consumers(connector))
            for port in self._inputs.get(connector, ()):
                for functionality in self.change.component_of(port.instance).users(port.port):
                    found[FunctionalityRef(port.instance, functionality.name)] = None
            self._consumers[connector] = list(found)
        return self._consumers[connector]


@dataclass(frozen=True, slots=True)
class Schedule:
    """For each step: ``dependencies`` are the earlier ones that it must wait for, it commutes with the others.

    ``shifts`` are the functionalities that fall below their baselines by it, or rise towards them.
    """

    dependencies: tuple[tuple[int, ...], ...]
    shifts: tuple[tuple[LevelChange, ...], ...]


def schedule(steps: Sequence[Step], levels: Levels) -> Schedule:
    """The schedule of ``steps``, which are valid one after another."""
    marker = _Marker(levels.change)
    earlier: dict[Mark, list[int]] = defaultdict(list)
    dependencies: list[tuple[int, ...]] = []
    shifts: list[tuple[LevelChange, ...]] = []
    last_fall = 0
    for index, (step, (_, meter)) in enumerate(zip(steps, islice(follow(levels, steps), 1, None), strict=True)):
        marks = dict.fromkeys(marker.of(step))
        waits: set[int] = set()
        for thing, access in marks:
            for awaited in _WAITS_FOR.get(access, ()):
                waits.update(earlier.get((thing, awaited), ()))
        if any(shift.after > shift.before for shift in meter.changes):
            # For every earlier one: the last step by which something falls waits for those before it.
            waits.update(range(last_fall, index))
            last_fall = index
        dependencies.append(tuple(sorted(waits)))
        shifts.append(meter.changes)
        for mark in marks:
            earlier[mark].append(index)
    return Schedule(tuple(dependencies), tuple(shifts))


def makespan(steps: Sequence[Step], levels: Levels) -> float:
    """The critical path (s): each step begins as soon as all those it waits for are done."""
    ends: list[float] = []
    for step, awaited in zip(steps, schedule(steps, levels).dependencies, strict=True):
        ends.append(max((ends[index] for index in awaited), default=0.0) + step.seconds)
    return round(max(ends, default=0.0), DIGITS)
