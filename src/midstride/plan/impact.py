"""The impact of each node on the others: which functionalities degrade, and how far, if it is removed or crashes.

Both lead to the same modes: ``best`` of what remains (docs/protocols/faults.md). Only the way there differs.
"""

from __future__ import annotations

from collections.abc import Iterable

import msgspec

from midstride.codec.form import Form
from midstride.model.best import lowered
from midstride.model.configuration import Configuration
from midstride.model.diagnosis import Diagnosis
from midstride.model.specification import Specification, initial
from midstride.plan.request import require


class ImpactedFunctionality(Form, frozen=True, omit_defaults=False):
    """A functionality that degrades by ``levels`` modes, and why."""

    functionality: str
    before: str = msgspec.field(name="from")
    after: str = msgspec.field(name="to")
    levels: int
    weight: float
    because: tuple[str, ...]

    @property
    def loss(self) -> float:
        return self.levels * self.weight


class Impact(Form, frozen=True, omit_defaults=False):
    """The functionalities that degrade without a node (`midstride impact --json`).

    ``own`` are its functionalities, lost with it. ``together``: the nodes that a crash of it ends as well, as they
    share its process; what degrades then is the impact of the container, whose own are those of its nodes.

    ``loss`` adds up the levels that others lose, times their weight. The node is a single point of failure if a
    functionality of another node degrades to its last mode.
    """

    role: str = msgspec.field(name="node")
    component: str
    single_point_of_failure: bool
    loss: float
    own: tuple[str, ...]
    together: tuple[str, ...]
    impacted: tuple[ImpactedFunctionality, ...]


def impacts(specification: Specification, roles: Iterable[str] = ()) -> list[Impact]:
    """The impact of each role and container (of those named, if any), single points of failure and great losses first.

    Raises PlanRefused for a name that is neither. The cost of each follows its forward cone.
    """
    containers = {name: members for name in specification.containers if (members := specification.members_of(name))}
    named = list(roles) or [*specification.roles(), *sorted(containers)]
    for name in named:
        kind = "node or container" if containers else "node"
        require(kind, name, {*specification.nodes, *containers})
    configuration = initial(specification)
    found = [_impact(specification, configuration, name, containers.get(name)) for name in named]
    return sorted(found, key=lambda impact: (not impact.single_point_of_failure, -impact.loss, impact.role))


def _impact(specification: Specification, configuration: Configuration, name: str, members: list[str] | None) -> Impact:
    """The impact of a node or, with its ``members``, of a container."""
    gone = [name] if members is None else members
    refs = [ref for role in gone for ref in configuration.instances[role].functionality_refs()]
    without = configuration
    for role in gone:
        without = without.without_instance(role)
    users = (user for own in refs for user in configuration.downstream(own))
    modes = lowered(without, [user for user in users if user.instance not in gone])
    diagnosis = Diagnosis(without.with_modes(modes))
    impacted = []
    for ref, index in sorted(modes.items()):
        functionality, held = configuration.functionality(ref), configuration.modes[ref]
        before, after = functionality.modes[held].name, functionality.modes[index].name
        because = diagnosis.chain(ref, held)
        impacted.append(ImpactedFunctionality(str(ref), before, after, index - held, functionality.weight, because))
    if members is None:
        node = specification.nodes[name]
        component, own = node.component, tuple(ref.functionality for ref in refs)
        others = [] if node.container is None else specification.members_of(node.container)
        together = tuple(other for other in others if other != name)
    else:
        component, own = specification.containers[name].run, tuple(map(str, refs))
        together = tuple(members)
    return Impact(
        role=name,
        component=component,
        single_point_of_failure=any(
            index == configuration.functionality(ref).last_mode for ref, index in modes.items()
        ),
        loss=sum(each.loss for each in impacted),
        own=own,
        together=together,
        impacted=tuple(sorted(impacted, key=lambda each: -each.loss)),
    )
