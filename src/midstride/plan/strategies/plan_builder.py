"""A plan in the making: structural actions go in, the mode changes they need come with them.

Every strategy writes its plan with this. The strategies differ in what they call and when; that the steps are
valid and in a good order is ensured here (docs/semantics.md section 5, F3).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

from immutables import Map

from midstride.model.action import Action, Attach, Create, Detach, Handover, Remove, SetParameters, Swap
from midstride.model.best import consumers_of, lowered, rebalanced
from midstride.model.component import FunctionalityRef, ParameterValue
from midstride.model.configuration import Configuration, Instance
from midstride.plan.change import Change, PortAttachment
from midstride.plan.constraints import ConstraintMonitor
from midstride.plan.disruption import DisruptionMeter, Levels
from midstride.plan.step import Step, mode_changes
from midstride.plan.strategies.mode_ordering import Modes, degradations, upgrades

Ceiling = Callable[[FunctionalityRef], int]


@dataclass(frozen=True, slots=True)
class PlanBuilder:
    """The configuration reached, the steps that led there (``numbered`` from 1), and their cost.

    An immutable value: each method yields the plan with further steps.
    ``touched`` holds the functionalities that might be able to enter a better mode since something changed;
    :meth:`raise_touched` raises them, at most to their ``ceiling`` if there is one. ``monitor`` keeps track of the
    user's constraints.
    """

    change: Change
    configuration: Configuration
    meter: DisruptionMeter
    touched: Map[FunctionalityRef, None] = field(default_factory=Map)
    ceiling: Ceiling | None = None
    monitor: ConstraintMonitor | None = None
    numbered: Map[int, Step] = field(default_factory=Map)

    @classmethod
    def at_start(
        cls, levels: Levels, ceiling: Ceiling | None = None, monitor: ConstraintMonitor | None = None
    ) -> PlanBuilder:
        """The plan without a step."""
        change = levels.change
        touched: Map[FunctionalityRef, None] = Map((ref, None) for ref in change.pending)
        return cls(change, change.start, DisruptionMeter.at_start(levels), touched, ceiling, monitor)

    @property
    def steps(self) -> tuple[Step, ...]:
        return tuple(self.numbered[number] for number in range(1, len(self.numbered) + 1))

    @property
    def is_doomed(self) -> bool:
        """Return whether a constraint is broken that no further step can repair."""
        return self.monitor is not None and self.monitor.is_doomed(self.meter)

    def do(self, *actions: Action) -> PlanBuilder:
        """Append actions as they are."""
        if not actions:
            return self
        configuration, meter, monitor, numbered = self.configuration, self.meter, self.monitor, self.numbered
        for number, action in enumerate(actions, start=len(numbered) + 1):
            roles = tuple(dict.fromkeys(self.change.role_of(name) for name in action.instances()))
            estimate = self.change.estimate_of(action)
            step = Step(action, estimate.seconds, roles, mode_changes(configuration, action), estimate.between)
            numbered = numbered.set(number, step)
            configuration = action.effect(configuration)
            meter = meter.after(action, step.seconds, configuration)
            if monitor is not None:
                monitor = monitor.after(number, step, configuration)
        return PlanBuilder(self.change, configuration, meter, self.touched, self.ceiling, monitor, numbered)

    def touching(self, refs: Iterable[FunctionalityRef]) -> PlanBuilder:
        """Have :meth:`raise_touched` look at ``refs`` as well."""
        return replace(self, touched=self.touched.update(dict.fromkeys(refs)))

    def raise_touched(self) -> PlanBuilder:
        """Upgrade every functionality that has become able to enter a better mode since the last call."""
        if not self.touched:
            return self
        live = [ref for ref in self.touched if ref.instance in self.configuration.instances]
        modes = rebalanced(self.configuration, live, self.ceiling)
        return replace(self, touched=Map()).raise_to(modes)

    def raise_to(self, modes: Modes) -> PlanBuilder:
        """Upgrade to ``modes``, upstream first."""
        return self.do(*upgrades(self.configuration, modes)) if modes else self

    def lower_to(self, modes: Modes) -> PlanBuilder:
        """Degrade to ``modes``, downstream first."""
        return self.do(*degradations(self.configuration, modes)) if modes else self

    def create(self, *instances: Instance) -> PlanBuilder:
        created = self.do(*(Create(instance) for instance in instances))
        return created.touching(ref for instance in instances for ref in instance.functionality_refs())

    def attach(self, *attachments: PortAttachment) -> PlanBuilder:
        """Attach, outputs first; call :meth:`raise_touched` later, once for many.

        So inputs are next to each other, as outputs are: those of different components are attached at once.
        """
        in_order = sorted(attachments, key=lambda pair: not self.configuration.is_output(pair[0]))
        attached = self.do(*(Attach(port, connector) for port, connector in in_order))
        affected = (consumers_of(attached.configuration, port, connector) for port, connector in attachments)
        return attached.touching(ref for refs in affected for ref in refs)

    def hand_over(self, swaps: Sequence[Swap]) -> PlanBuilder:
        consumers = (ref for swap in swaps for ref in self.configuration.consumers(swap.connector))
        return self.do(Handover(tuple(swaps))).touching(consumers)

    def detach(self, attachments: Iterable[PortAttachment]) -> PlanBuilder:
        """Degrade to ``best`` of what will remain without all of these, then detach them one by one."""
        raised, pairs = self.raise_touched(), list(attachments)
        remaining = raised.configuration
        seeds: dict[FunctionalityRef, None] = {}
        for port, connector in pairs:
            seeds.update(dict.fromkeys(consumers_of(remaining, port, connector)))
            remaining = remaining.without_attachment(port, connector)
        return raised.lower_to(lowered(remaining, seeds)).do(*(Detach(port, connector) for port, connector in pairs))

    def remove(self, *names: str) -> PlanBuilder:
        return self.raise_touched().do(*(Remove(name) for name in names))

    def set_parameters(self, parameters: Iterable[tuple[str, Map[str, ParameterValue]]]) -> PlanBuilder:
        return self.do(*(SetParameters(name, values) for name, values in parameters))
