"""A plan in the making: structural actions go in, the mode changes they need come with them.

Every strategy writes its plan through this. What differs between strategies is when they call
what; that the steps are valid and ordered well is seen to here (semantics.md section 5, F3).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from immutables import Map

from midstride.model.action import Action, Attach, Create, Detach, Handover, Remove, SetParameters, Swap
from midstride.model.best import consumers_of, lowered, rebalanced
from midstride.model.component import FunctionalityRef, ParameterValue, PortRef
from midstride.model.configuration import Instance
from midstride.plan.change import Attachment, Change
from midstride.plan.constraints import ConstraintMonitor
from midstride.plan.disruption import DisruptionMeter, Levels, instances_touched
from midstride.plan.mode_ordering import Modes, degradations, upgrades
from midstride.plan.step import Step, mode_changes

Ceiling = Callable[[FunctionalityRef], int]


class PlanBuilder:
    """The configuration reached, the steps that led there, and what they have cost so far.

    ``touched`` are the functionalities that might stand better since something changed;
    :meth:`rise` raises them. ``ceiling``, where given, bounds how far anybody is raised; ``watch``, where given,
    notes which of the user's constraints are broken.
    """

    __slots__ = ("ceiling", "change", "configuration", "meter", "steps", "touched", "watch")

    def __init__(
        self, change: Change, levels: Levels, ceiling: Ceiling | None = None, watch: ConstraintMonitor | None = None
    ) -> None:
        self.change = change
        self.configuration = change.start
        self.steps: list[Step] = []
        self.meter = DisruptionMeter(levels)
        self.touched: dict[FunctionalityRef, None] = dict.fromkeys(change.pending)
        self.ceiling = ceiling
        self.watch = watch

    @property
    def is_doomed(self) -> bool:
        """Whether a constraint is broken that no further step can mend."""
        return self.watch is not None and self.watch.is_doomed(self.meter)

    def copy(self) -> PlanBuilder:
        twin = PlanBuilder.__new__(PlanBuilder)
        twin.change, twin.configuration, twin.ceiling = self.change, self.configuration, self.ceiling
        twin.steps, twin.meter, twin.touched = list(self.steps), self.meter.copy(), dict(self.touched)
        twin.watch = None if self.watch is None else self.watch.copy()
        return twin

    def do(self, action: Action) -> None:
        """Append one action as it is."""
        roles = tuple(dict.fromkeys(self.change.role_of(name) for name in instances_touched(action)))
        component = action.instance.component if isinstance(action, Create) else None
        if isinstance(action, Remove):
            component = self.configuration.component(action.instance)
        seconds = self.change.seconds(action.kind, component)
        step = Step(action, seconds, roles, mode_changes(self.configuration, action))
        self.configuration = action.effect(self.configuration)
        self.meter.step(action, seconds, self.configuration)
        self.steps.append(step)
        if self.watch is not None:
            self.watch.note(step, self.configuration)

    # -- modes ---------------------------------------------------------------------------------------

    def rise(self) -> None:
        """Upgrade whoever can stand better since the last time."""
        if self.touched:
            live = [ref for ref in self.touched if ref.instance in self.configuration.instances]
            self.touched = {}
            self.raise_to(rebalanced(self.configuration, live, self.ceiling))

    def raise_to(self, modes: Modes) -> None:
        """Upgrade to ``modes``, upstream first."""
        for upgrade in upgrades(self.configuration, modes):
            self.do(upgrade)

    def lower_to(self, modes: Modes) -> None:
        """Degrade to ``modes``, downstream first."""
        for degradation in degradations(self.configuration, modes):
            self.do(degradation)

    # -- structure -----------------------------------------------------------------------------------

    def create(self, instance: Instance) -> None:
        self.do(Create(instance))
        self.touched.update(dict.fromkeys(instance.functionality_refs()))

    def attach(self, port: PortRef, connector: str) -> None:
        """Attach; :meth:`rise` later, once for many."""
        self.do(Attach(port, connector))
        self.touched.update(dict.fromkeys(consumers_of(self.configuration, port, connector)))

    def hand_over(self, swaps: Sequence[Swap]) -> None:
        self.do(Handover(tuple(swaps)))
        for swap in swaps:
            self.touched.update(dict.fromkeys(self.configuration.consumers(swap.connector)))

    def detach(self, attachments: Iterable[Attachment]) -> None:
        """Degrade to ``best`` of what will remain without all of these, then detach them one by one."""
        self.rise()
        pairs = list(attachments)
        left = self.configuration
        seeds: dict[FunctionalityRef, None] = {}
        for port, connector in pairs:
            seeds.update(dict.fromkeys(consumers_of(left, port, connector)))
            left = left.without_attachment(port, connector)
        self.lower_to(lowered(left, seeds))
        for port, connector in pairs:
            self.do(Detach(port, connector))

    def remove(self, name: str) -> None:
        self.rise()
        self.do(Remove(name))

    def set(self, name: str, parameters: Map[str, ParameterValue]) -> None:
        self.do(SetParameters(name, parameters))
