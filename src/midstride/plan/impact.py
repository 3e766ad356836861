"""The impact of each node on the others: which functionalities degrade, and how far, if it is removed or crashes.

Both lead to the same modes: ``best`` of what remains (docs/semantics.md section 7). Only the way there differs.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import msgspec

from midstride.codec.form import Form
from midstride.model.best import lowered
from midstride.model.component import FunctionalityRef
from midstride.model.configuration import Configuration
from midstride.model.diagnosis import Diagnosis
from midstride.model.specification import Specification, initial
from midstride.plan.request import require


@dataclass(frozen=True, slots=True)
class ImpactedFunctionality:
    """A functionality that degrades by ``levels`` modes, and why."""

    functionality: FunctionalityRef
    before: str
    after: str
    levels: int
    weight: float
    is_last: bool
    because: tuple[str, ...]

    @property
    def loss(self) -> float:
        return self.levels * self.weight


@dataclass(frozen=True, slots=True)
class Impact:
    """What degrades without ``role``. ``own`` are its own functionalities, which are lost with it."""

    role: str
    component: str
    impacted: tuple[ImpactedFunctionality, ...]
    own: tuple[str, ...]

    @property
    def loss(self) -> float:
        """The levels that others lose, times their weight."""
        return sum(each.loss for each in self.impacted)

    @property
    def single_point_of_failure(self) -> bool:
        """Whether a functionality of another component degrades to its last mode."""
        return any(each.is_last for each in self.impacted)


class ImpactedForm(Form, frozen=True, omit_defaults=False):
    """A functionality that falls, in JSON."""

    functionality: str
    before: str = msgspec.field(name="from")
    after: str = msgspec.field(name="to")
    levels: int
    weight: float
    because: list[str]


class ImpactForm(Form, frozen=True, omit_defaults=False):
    """What falls if a node is gone, in JSON (`midstride impact --json`)."""

    node: str
    component: str
    single_point_of_failure: bool
    loss: float
    own: list[str]
    falls: list[ImpactedForm]

    @classmethod
    def of(cls, impact: Impact) -> ImpactForm:
        return cls(
            node=impact.role,
            component=impact.component,
            single_point_of_failure=impact.single_point_of_failure,
            loss=impact.loss,
            own=list(impact.own),
            falls=[
                ImpactedForm(
                    functionality=str(each.functionality),
                    before=each.before,
                    after=each.after,
                    levels=each.levels,
                    weight=each.weight,
                    because=list(each.because),
                )
                for each in impact.impacted
            ],
        )


def impacts(specification: Specification, roles: Iterable[str] = ()) -> list[Impact]:
    """The impact of each role (of ``roles``, where any are named), single points of failure and great losses first.

    Raises PlanRefused for an unknown role. The cost of each follows its forward cone.
    """
    named = list(roles) or specification.roles()
    for role in named:
        require("node", role, specification.nodes)
    configuration = initial(specification)
    found = [_impact(specification, configuration, role) for role in named]
    return sorted(found, key=lambda impact: (not impact.single_point_of_failure, -impact.loss, impact.role))


def _impact(specification: Specification, configuration: Configuration, role: str) -> Impact:
    instance = configuration.instances[role]
    users: dict[FunctionalityRef, None] = {}
    for port, connector in configuration.attached_ports(role):
        if configuration.is_output(port):
            users.update(dict.fromkeys(configuration.consumers(connector)))
    without = configuration.without_instance(role)
    modes = lowered(without, [ref for ref in users if ref.instance != role])
    after = without.with_modes(modes)
    impacted = sorted(_impacted(configuration, after, modes), key=lambda each: (-each.loss, each.functionality))
    own = tuple(name for name in instance.component.functionality_order)
    return Impact(role, specification.nodes[role].component, tuple(impacted), own)


def _impacted(
    before: Configuration, after: Configuration, modes: dict[FunctionalityRef, int]
) -> Iterator[ImpactedFunctionality]:
    diagnosis = Diagnosis(after)
    for ref, index in modes.items():
        functionality = before.functionality(ref)
        held = before.modes[ref]
        yield ImpactedFunctionality(
            ref,
            functionality.modes[held].name,
            functionality.modes[index].name,
            index - held,
            functionality.weight,
            index == functionality.last_mode,
            diagnosis.chain(ref, held),
        )
