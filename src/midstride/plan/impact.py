"""What each component means to the others: what falls, and how far, if it is removed or crashes.

Both end in the same place: ``best`` of what is left (semantics.md section 7). What differs is the way there,
which is a plan's matter.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import msgspec

from midstride.codec.form import Form
from midstride.errors import PlanRefused
from midstride.model.best import lowered
from midstride.model.component import FunctionalityRef
from midstride.model.configuration import Configuration
from midstride.model.diagnosis import Diagnosis
from midstride.model.diagnostics import suggestion
from midstride.model.specification import Specification, initial


@dataclass(frozen=True, slots=True)
class ImpactedFunctionality:
    """A functionality that falls, by ``levels`` modes, and why it cannot stay."""

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
    """What falls if ``role`` is gone. ``own`` are its own functionalities, which go with it."""

    role: str
    component: str
    falls: tuple[ImpactedFunctionality, ...]
    own: tuple[str, ...]

    @property
    def loss(self) -> float:
        """The levels that others lose, by weight."""
        return sum(fall.loss for fall in self.falls)

    @property
    def single_point_of_failure(self) -> bool:
        """Whether another component's functionality falls to its last mode."""
        return any(fall.is_last for fall in self.falls)


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
                    functionality=str(fall.functionality),
                    before=fall.before,
                    after=fall.after,
                    levels=fall.levels,
                    weight=fall.weight,
                    because=list(fall.because),
                )
                for fall in impact.falls
            ],
        )


def impacts(specification: Specification, roles: Iterable[str] = ()) -> list[Impact]:
    """The impact of each role (of ``roles``, where any are named), single points of failure and great losses first.

    Raises PlanRefused for a role that there is not. The cost of each follows its forward cone.
    """
    named = list(roles) or specification.roles()
    for role in named:
        if role not in specification.nodes:
            raise PlanRefused(f"there is no node {role}; {suggestion(role, specification.nodes)}")
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
    falls = sorted(_falls(configuration, after, modes), key=lambda fall: (-fall.loss, fall.functionality))
    own = tuple(name for name in instance.component.functionality_order)
    return Impact(role, specification.nodes[role].component, tuple(falls), own)


def _falls(
    before: Configuration, after: Configuration, modes: dict[FunctionalityRef, int]
) -> Iterator[ImpactedFunctionality]:
    why = Diagnosis(after)
    for ref, index in modes.items():
        functionality = before.functionality(ref)
        stood = before.modes[ref]
        yield ImpactedFunctionality(
            ref,
            functionality.modes[stood].name,
            functionality.modes[index].name,
            index - stood,
            functionality.weight,
            index == functionality.last_mode,
            why.chain(ref, stood),
        )
