"""A specification: a whole system as its author declares it (docs/semantics.md sections 2 and 6).

A node of a specification is a *role*. :func:`initial` yields the configuration in which the specified system starts;
the planners lead from a running configuration to another specification.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

from immutables import Map

from midstride.model.best import best
from midstride.model.component import (
    DEFAULT_CONTAINER,
    ROS_PARAMETERS,
    ComponentSpec,
    Connector,
    ContainerProgram,
    EnvironmentGuarantee,
    FunctionalityRef,
    ParameterSection,
    ParameterValue,
    PortRef,
    Resource,
    SharedContainer,
)
from midstride.model.configuration import Configuration, Instance, SystemContext, configure
from midstride.model.contract import Predicate, format_number
from midstride.model.hosts import OWN_HOST, HostSpec
from midstride.model.respawn import RespawnPolicy

# The duration of a step (s) where neither the file nor earlier runs provide one; the orders of magnitude are measured.
DEFAULT_SECONDS: Final[Mapping[str, float]] = Map(
    {
        "create": 1.0,
        "remove": 0.2,
        "attach": 0.1,
        "detach": 0.05,
        "degrade": 0.01,
        "upgrade": 0.01,
        "handover": 0.1,
        "set": 0.01,
    }
)
# What a hand-over takes its time for (s), where the file does not say (docs/protocols/probation.md). State that moves
# has ``state_timeout``: the topic is silent meanwhile, and requests wait (docs/protocols/state.md).
HANDOVER_SECONDS: Final[Mapping[str, float]] = Map({"probation_timeout": 5.0, "watch_after": 0.0, "state_timeout": 2.0})
TIMING: Final = (*DEFAULT_SECONDS, "probation", *HANDOVER_SECONDS)
# An output with a rate is judged over so many of its periods, within bounds (s), where the file states no probation;
# and over no less than so many in any case.
PROBATION_PERIODS: Final = 10
SHORTEST_PROBATION: Final = 0.2
LONGEST_PROBATION: Final = 2.0
FEWEST_PERIODS: Final = 5


def handover_seconds(timing: Mapping[str, float], name: str) -> float:
    """The time that ``timing`` states for one of HANDOVER_SECONDS, or its default (s)."""
    return timing.get(name, HANDOVER_SECONDS[name])


def probation_seconds(timing: Mapping[str, float], rate: float | None) -> float:
    """Over how long (s) a new publisher must keep ``rate`` (Hz) behind its gate; 0 if it need not.

    That is what ``timing`` states as ``probation``, else a default; never less than FEWEST_PERIODS of the rate.
    """
    stated = timing.get("probation")
    if not rate or stated == 0:
        return 0.0
    window = min(max(SHORTEST_PROBATION, PROBATION_PERIODS / rate), LONGEST_PROBATION) if stated is None else stated
    return max(window, FEWEST_PERIODS / rate)


@dataclass(frozen=True, slots=True)
class Node:
    """A role: its component, the topics its ports are attached to, and its own parameter values.

    ``respawn``: whether and when it is started again after a crash (None: it is not). ``sections``: those of its
    parameter files for further nodes in its process, in their order, where its program does not use Midstride's API.
    ``container``: the one of the system that loads it, where it is a composable node that shares its process.
    ``host``: the one that it runs on.
    """

    role: str
    component: str
    attachments: Map[str, tuple[str, ...]] = field(default_factory=Map)
    parameters: Map[str, ParameterValue] = field(default_factory=Map)
    respawn: RespawnPolicy | None = None
    sections: tuple[ParameterSection, ...] = ()
    container: str | None = None
    host: str = OWN_HOST


@dataclass(frozen=True, slots=True)
class Keep:
    """``keep r.f at mode``: the functionality never falls below that mode during a plan."""

    functionality: FunctionalityRef
    mode: str

    def __str__(self) -> str:
        return f"keep {self.functionality} at {self.mode}"


@dataclass(frozen=True, slots=True)
class Limit:
    """``limit r.f below baseline d s``: seconds below the baseline, summed over the plan."""

    functionality: FunctionalityRef
    seconds: float

    def __str__(self) -> str:
        return f"limit {self.functionality} below baseline {format_number(self.seconds)} s"


@dataclass(frozen=True, slots=True)
class Order:
    """``order a before b``: all structural actions of role ``a`` before those of ``b``."""

    first: str
    then: str

    def __str__(self) -> str:
        return f"order {self.first} before {self.then}"


Constraint = Keep | Limit | Order


@dataclass(frozen=True, slots=True)
class ChangeRequirement:
    """``changes require /topic : pkg/msg/Type where field = value max_age s``: a change may happen while that holds.

    It holds if the last message on ``topic`` meets ``assumption``, whose fields alone count, and is not older than
    ``max_age`` (s), if that is stated. ``recovery``: so may what the manager does without a command, by ``changes and
    recovery require``.
    """

    topic: str
    assumption: Predicate
    max_age: float | None = None
    recovery: bool = False

    def __str__(self) -> str:
        age = "" if self.max_age is None else f" max_age {format_number(self.max_age)} s"
        return f"changes{' and recovery' if self.recovery else ''} require {self.topic} : {self.assumption}{age}"


@dataclass(frozen=True, slots=True)
class Specification:
    """Everything a ``.stride`` file declares. ``timing`` holds what is stated of ``TIMING``, in s.

    ``requirements``: what has to hold for a change to happen. ``containers``: the programs of the containers that
    composable nodes share, by the names of the containers. ``resources``: by their keys, which name their hosts.
    ``hosts``: the computers besides that of the manager.
    """

    name: str
    connectors: Map[str, Connector] = field(default_factory=Map)
    components: Map[str, ComponentSpec] = field(default_factory=Map)
    nodes: Map[str, Node] = field(default_factory=Map)
    environment: tuple[EnvironmentGuarantee, ...] = ()
    resources: Map[str, Resource] = field(default_factory=Map)
    constraints: tuple[Constraint, ...] = ()
    timing: Map[str, float] = field(default_factory=Map)
    requirements: tuple[ChangeRequirement, ...] = ()
    containers: Map[str, ContainerProgram] = field(default_factory=Map)
    hosts: Map[str, HostSpec] = field(default_factory=Map)
    _context: SystemContext | None = field(default=None, init=False, compare=False, repr=False)

    @property
    def context(self) -> SystemContext:
        if self._context is None:
            object.__setattr__(self, "_context", SystemContext(self.connectors, self.environment, self.resources))
        return self._context  # type: ignore[return-value]  # just made

    def component_of(self, role: str) -> ComponentSpec:
        """Raises KeyError for an unknown role."""
        return self.components[self.nodes[role].component]

    def instance(self, role: str, name: str | None = None) -> Instance:
        """The instance of ``role`` called ``name`` (the role's own name where None)."""
        node = self.nodes[role]
        container = self.container_of(role)
        process = "" if container is None else container.name
        component = self.component_of(role)
        return Instance(name or role, role, component, node.parameters, node.sections, container, process, node.host)

    def container_of(self, role: str) -> SharedContainer | None:
        """The container that loads the node of ``role``; None where it shares none. Raises KeyError."""
        name = self.nodes[role].container
        if name is None:
            return None
        sections: list[ParameterSection] = []
        for member in self.members_of(name):
            sections += [each for each in self.nodes[member].sections if each not in sections]
        return SharedContainer(name, self.containers.get(name, DEFAULT_CONTAINER), tuple(sections))

    def members_of(self, container: str) -> list[str]:
        """The roles whose nodes that container loads, sorted."""
        return sorted(role for role, node in self.nodes.items() if node.container == container)

    def attachments_of(self, role: str, instance: str | None = None) -> list[tuple[PortRef, str]]:
        """The attachments of the role, outputs first, in order of declaration."""
        node, component = self.nodes[role], self.component_of(role)
        return [
            (PortRef(instance or role, port), connector)
            for port in component.ports()
            for connector in node.attachments.get(port, ())
        ]

    def roles(self) -> list[str]:
        return sorted(self.nodes)

    def with_node(self, node: Node) -> Specification:
        return self._with(nodes=self.nodes.set(node.role, node))

    def without_node(self, role: str) -> Specification:
        """Without the role, and without the constraints that name it. Raises KeyError for an unknown one."""
        constraints = tuple(c for c in self.constraints if role not in roles_of(c))
        return self._with(nodes=self.nodes.delete(role), constraints=constraints)

    def _with(self, **changes: Any) -> Specification:
        """With ``changes`` that leave the context as it is, so that it is shared."""
        context = self.context
        changed = replace(self, **changes)
        object.__setattr__(changed, "_context", context)
        return changed

    def with_replaced(self, role: str, component: str) -> Specification:
        """``role`` with another component, on the same topics, without the values of parameters that this one lacks.

        Raises KeyError for an unknown name.
        """
        node, declared = self.nodes[role], self.components[component].parameters
        parameters = Map(
            {name: value for name, value in node.parameters.items() if name in declared or name in ROS_PARAMETERS}
        )
        return self.with_node(replace(node, component=component, parameters=parameters))


def roles_of(constraint: Constraint) -> tuple[str, ...]:
    """The roles that a constraint names."""
    if isinstance(constraint, Order):
        return (constraint.first, constraint.then)
    return (constraint.functionality.instance,)


def structure(specification: Specification) -> Configuration:
    """Every node live under its role's name and attached as specified, every functionality in its last mode."""
    return configure(
        specification.context,
        (specification.instance(role) for role in specification.nodes),
        (attachment for role in specification.nodes for attachment in specification.attachments_of(role)),
    )


def initial(specification: Specification) -> Configuration:
    """The configuration in which the system starts: its structure, in the best modes that it allows."""
    return best(structure(specification))
