"""The syntax tree of a ``.stride`` file: frozen values with their spans.

Names are not resolved and nothing is checked here. A part that could not be parsed is missing, and the declaration it
belongs to records that (``incomplete``, ``skipped``), so that no error is derived from what is missing.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol, TypeAlias, TypeVar

from midstride.lang.lexer import Tokens
from midstride.lang.source import Span
from midstride.model.component import ParameterValue
from midstride.model.contract import ConnectorKind, Scalar


class Name(NamedTuple):
    """A name, a path, dotted names, or the value of a string."""

    text: str
    span: Span


class Named(Protocol):
    """A declaration with a name."""

    @property
    def name(self) -> Name: ...


N = TypeVar("N", bound=Named)


def find(entries: Iterable[N], name: str) -> N | None:
    """The declaration with that name, if there is one."""
    return next((entry for entry in entries if entry.name.text == name), None)


class Number(NamedTuple):
    value: float
    span: Span


class Value(NamedTuple):
    """The value of a parameter."""

    value: ParameterValue
    span: Span


class ScalarValue(NamedTuple):
    value: Scalar
    span: Span


# -- contracts ------------------------------------------------------------------------------------------


class FieldConstraint(NamedTuple):
    """``path operator values``: one of ``= < <= > >=`` with one value, ``in {}`` with any number of values, ``in []``
    with two numbers."""

    path: Name
    operator: str
    values: tuple[ScalarValue, ...]
    span: Span


class QoSPolicy(NamedTuple):
    """One QoS policy, ``name = value``, with the unit of a duration if one is given."""

    name: Name
    value: ScalarValue
    unit: Name | None


class BoundClause(NamedTuple):
    """``responds within SECONDS`` or ``accepts within SECONDS``."""

    word: Name
    seconds: Number
    span: Span


class ContractExpression(NamedTuple):
    """A type or a named contract, with rate, QoS, field constraints and bound. ``base`` None: `nothing`."""

    span: Span
    base: Name | None
    rate: Number | None = None
    qos: tuple[QoSPolicy, ...] = ()
    where: tuple[FieldConstraint, ...] = ()
    bound: BoundClause | None = None

    @property
    def is_bare_name(self) -> bool:
        """Return whether the expression is a single name, as an input's name would be."""
        plain = self.rate is None and not self.qos and not self.where and self.bound is None
        return plain and self.base is not None and "/" not in self.base.text


# -- components -----------------------------------------------------------------------------------------


class StopClause(NamedTuple):
    """``stop drain SECONDS patience SECONDS sigterm SECONDS sigkill SECONDS``, of which any three may be missing."""

    drain: Number | None
    patience: Number | None
    sigterm: Number | None
    sigkill: Number | None
    span: Span


class ContainerClause(NamedTuple):
    """``in "component_container_mt" package "rclcpp_components"``: the program that loads a composable node."""

    program: Name | None
    package: Name | None


class Run(NamedTuple):
    """``container``: the command is the class of a composable node; what it leaves out is None in it."""

    command: Name
    package: Name | None
    container: ContainerClause | None
    prefix: Name | None
    startup: Number | None
    activate: Number | None
    stop: StopClause | None
    gate: Name | None
    once: Span | None
    unnamed: bool
    renames: Name | None
    span: Span


class EnvironmentVariable(NamedTuple):
    """A variable of the process's environment; ``value`` None: it is not inherited."""

    name: Name
    value: Name | None


class ResourceUse(NamedTuple):
    resource: Name
    amount: Number | None


class ParameterEntry(NamedTuple):
    """``after``: how many of the parameter files of its component or node come before it. ``for_all``: it is for all
    nodes of the process."""

    name: Name
    value: Value
    changeable: bool
    after: int
    for_all: bool = False


class InputDeclaration(NamedTuple):
    """``input NAME : CONTRACT``, or ``client NAME : CONTRACT``, or ``action client NAME : CONTRACT``."""

    name: Name
    contract: ContractExpression
    tolerates: Number | None
    condition: Span | None
    kind: ConnectorKind = "topic"


class ServerDeclaration(NamedTuple):
    """An output that was declared as ``server NAME`` or ``action server NAME``."""

    name: Name
    kind: ConnectorKind


class OwnTopic(NamedTuple):
    """The name that a program which does not use Midstride's API has for the topic of a port."""

    name: Name  # of the port
    topic: Name


class AllowedEndpoint(NamedTuple):
    kind: str
    name: Name


class NamedAssumption(NamedTuple):
    """``left or right``."""

    inputs: tuple[Name, ...]
    span: Span


class GuaranteeStatement(NamedTuple):
    output: Name
    contract: ContractExpression


AssumptionExpression: TypeAlias = "NamedAssumption | ContractExpression"


class ModeDeclaration(NamedTuple):
    name: Name
    assumptions: tuple[AssumptionExpression, ...]
    guarantees: tuple[GuaranteeStatement, ...]
    parameters: tuple[ParameterEntry, ...]
    incomplete: bool


class FunctionalityDeclaration(NamedTuple):
    name: Name
    weight: Number | None
    uses: tuple[Name, ...]
    produces: tuple[Name, ...]
    modes: tuple[ModeDeclaration, ...]
    incomplete: bool


class ComponentDeclaration(NamedTuple):
    name: Name
    like: Name | None
    runs: tuple[Run, ...]
    holds: tuple[tuple[ResourceUse, ...], ...]
    parameters: tuple[ParameterEntry, ...]
    files: tuple[Name, ...]
    environment: tuple[EnvironmentVariable, ...]
    inputs: tuple[InputDeclaration, ...]
    outputs: tuple[Name, ...]
    allows: tuple[AllowedEndpoint, ...]
    functionalities: tuple[FunctionalityDeclaration, ...]
    topics: tuple[OwnTopic, ...]
    lazy: tuple[Name, ...]  # outputs
    served: tuple[ServerDeclaration, ...]  # outputs
    skipped: frozenset[str]  # the first words of the statements that could not be parsed


# -- the rest of a file ---------------------------------------------------------------------------------


class HostDeclaration(NamedTuple):
    """``host NAME { ssh "…" setup "…" folder "…" }``; each may be left out."""

    name: Name
    ssh: Name | None = None
    setup: Name | None = None
    folder: Name | None = None


class IncludeStatement(NamedTuple):
    """``include "PATH" on HOST``."""

    path: Name
    host: Name | None = None


class ContractDeclaration(NamedTuple):
    name: Name
    contract: ContractExpression | None


class TopicDeclaration(NamedTuple):
    """``topic NAME : CONTRACT``, or ``service NAME : CONTRACT``, or ``action NAME : CONTRACT``."""

    name: Name
    contract: ContractExpression | None
    max_publishers: Number | None
    kind: ConnectorKind = "topic"


class ResourceDeclaration(NamedTuple):
    name: Name
    capacity: Number | None
    host: Name | None = None


class ContainerDeclaration(NamedTuple):
    """``container NAME on HOST { run "PROGRAM" package "PACKAGE" environment { … } }``; what is in the braces may be
    left out.

    ``run``: the program, with its ``prefix``, ``startup`` and ``stop``, as for a component.
    """

    name: Name
    run: Run | None
    environment: tuple[EnvironmentVariable, ...] = ()
    host: Name | None = None


class EnvironmentOffer(NamedTuple):
    name: Name
    topic: Name | None
    contract: ContractExpression


class Attachment(NamedTuple):
    """``port <- topic, …`` (an input) or ``port -> topic, …`` (an output)."""

    port: Name
    is_output: bool
    topics: tuple[Name, ...]


class RespawnStatement(NamedTuple):
    """``respawn``, ``respawn_delay AMOUNT to BOUND``, ``respawn_max_retries AMOUNT in BOUND``,
    ``respawn_max_retries unlimited`` or ``respawn_fallback COMPONENT on HOST lease AMOUNT``."""

    keyword: Name
    span: Span
    amount: Number | None = None
    bound: Number | None = None
    component: Name | None = None
    unlimited: bool = False
    host: Name | None = None


class NodeDeclaration(NamedTuple):
    name: Name
    component: Name | None
    attachments: tuple[Attachment, ...]
    parameters: tuple[ParameterEntry, ...]
    files: tuple[Name, ...]
    respawn: tuple[RespawnStatement, ...]
    incomplete: bool
    container: Name | None = None
    host: Name | None = None


class NamespaceBlock(NamedTuple):
    """``namespace NAME on HOST { … }``."""

    name: Name
    items: tuple[Item, ...]
    host: Name | None = None


class ParameterFile(NamedTuple):
    """``parameters "nav2.yaml"`` outside any component or node: applies to every role the file has a section for."""

    path: Name


class FunctionalityName(NamedTuple):
    """``role.functionality``."""

    role: Name
    functionality: Name

    @property
    def span(self) -> Span:
        return self.role.span.to(self.functionality.span)


class KeepStatement(NamedTuple):
    span: Span
    functionality: FunctionalityName
    mode: Name


class LimitStatement(NamedTuple):
    span: Span
    functionality: FunctionalityName
    seconds: Number


class OrderStatement(NamedTuple):
    span: Span
    first: Name
    then: Name


class ChangesStatement(NamedTuple):
    """``changes require TOPIC : CONTRACT max_age SECONDS``; ``recovery``: ``changes and recovery require …``."""

    span: Span
    topic: Name
    contract: ContractExpression
    max_age: Number | None
    recovery: bool


class StepDuration(NamedTuple):
    kind: Name
    seconds: Number


ConstraintStatement: TypeAlias = "KeepStatement | LimitStatement | OrderStatement"
Item: TypeAlias = (
    "IncludeStatement | ContractDeclaration | TopicDeclaration | ResourceDeclaration | EnvironmentOffer"
    " | HostDeclaration | ContainerDeclaration | ComponentDeclaration | NodeDeclaration | NamespaceBlock"
    " | ParameterFile | ConstraintStatement | StepDuration | ChangesStatement"
)


@dataclass(frozen=True, slots=True)
class SourceLayout:
    """The facts about the tokens that the printer needs besides their text, by token index.

    ``statements``: the first token of each statement, with its separator from a previous one on the same line.
    ``items``: the tokens that follow a comma. ``blocks``: the opening and closing braces of blocks (not of value sets).
    ``marks``: the tokens to align on adjacent lines, by kind of line.
    """

    statements: dict[int, str] = field(default_factory=dict)
    items: set[int] = field(default_factory=set)
    blocks: dict[int, int] = field(default_factory=dict)
    marks: dict[int, str] = field(default_factory=dict)


class File(NamedTuple):
    """A whole file. ``skipped`` holds the names in the parts that could not be parsed, which may declare them."""

    tokens: Tokens
    layout: SourceLayout
    system: Name | None
    items: tuple[Item, ...]
    skipped: frozenset[str]
