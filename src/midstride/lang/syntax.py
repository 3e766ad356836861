"""The syntax of a ``.stride`` file as frozen values, each with its place.

Names are not resolved here and nothing is judged: this is what the file says. A part that could
not be read is left out, and the declaration it belongs to says so (``broken``, ``lost``), so that nothing
is concluded from what is missing.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

from midstride.lang.lexer import Tokens
from midstride.lang.source import Span
from midstride.model.component import ParameterValue
from midstride.model.contract import Scalar


class Name(NamedTuple):
    """A word of the file: a name, a path, dotted names, or what stands in a text."""

    text: str
    span: Span


class Number(NamedTuple):
    value: float
    span: Span


class Value(NamedTuple):
    """A value a field or parameter is given."""

    value: ParameterValue
    span: Span


class ScalarValue(NamedTuple):
    value: Scalar
    span: Span


# -- contracts ------------------------------------------------------------------------------------------


class FieldConstraint(NamedTuple):
    """``path operator values``: one of ``= < <= > >=`` with one value, ``in {}`` with any, ``in []`` with two
    numbers."""

    path: Name
    operator: str
    values: tuple[ScalarValue, ...]
    span: Span


class Policy(NamedTuple):
    """One QoS policy, ``name = value``, with the unit of a duration where one stands there."""

    name: Name
    value: ScalarValue
    unit: Name | None


class ContractExpression(NamedTuple):
    """A message type or a named contract, and what is stated beside it. ``base`` None: `nothing`."""

    span: Span
    base: Name | None
    rate: Number | None = None
    qos: tuple[Policy, ...] = ()
    where: tuple[FieldConstraint, ...] = ()

    @property
    def is_bare_name(self) -> bool:
        """Whether it is one name and no more, as an input's name would be."""
        plain = self.rate is None and not self.qos and not self.where
        return plain and self.base is not None and "/" not in self.base.text


# -- components -----------------------------------------------------------------------------------------


class Run(NamedTuple):
    command: Name
    takes: Number | None
    span: Span


class Held(NamedTuple):
    resource: Name
    amount: Number | None


class ParameterEntry(NamedTuple):
    name: Name
    value: Value
    changeable: bool


class InputDeclaration(NamedTuple):
    name: Name
    contract: ContractExpression | None


class Allowed(NamedTuple):
    kind: str
    name: Name
    span: Span


class NamedAssumption(NamedTuple):
    """``left or right``."""

    inputs: tuple[Name, ...]
    span: Span


class GuaranteeStatement(NamedTuple):
    output: Name
    contract: ContractExpression | None
    span: Span


Assumed: TypeAlias = "NamedAssumption | ContractExpression"


class ModeDeclaration(NamedTuple):
    span: Span
    name: Name
    assumptions: tuple[Assumed, ...]
    guarantees: tuple[GuaranteeStatement, ...]
    broken: bool


class FunctionalityDeclaration(NamedTuple):
    span: Span
    name: Name
    weight: Number | None
    uses: tuple[Name, ...]
    produces: tuple[Name, ...]
    modes: tuple[ModeDeclaration, ...]
    broken: bool


class ComponentDeclaration(NamedTuple):
    span: Span
    name: Name
    like: Name | None
    runs: tuple[Run, ...]
    holds: tuple[tuple[Held, ...], ...]
    parameters: tuple[ParameterEntry, ...]
    files: tuple[Name, ...]
    inputs: tuple[InputDeclaration, ...]
    outputs: tuple[Name, ...]
    allows: tuple[Allowed, ...]
    functionalities: tuple[FunctionalityDeclaration, ...]
    lost: frozenset[str]  # the first words of the statements that could not be read


# -- the rest of a file ---------------------------------------------------------------------------------


class IncludeStatement(NamedTuple):
    span: Span
    path: Name


class ContractDeclaration(NamedTuple):
    span: Span
    name: Name
    contract: ContractExpression | None


class TopicDeclaration(NamedTuple):
    span: Span
    name: Name
    contract: ContractExpression | None
    cap: Number | None


class ResourceDeclaration(NamedTuple):
    span: Span
    name: Name
    capacity: Number | None


class EnvironmentOffer(NamedTuple):
    span: Span
    name: Name
    topic: Name | None
    contract: ContractExpression | None


class EnvironmentBlock(NamedTuple):
    span: Span
    offers: tuple[EnvironmentOffer, ...]


class Attachment(NamedTuple):
    """``port <- topic`` (an input) or ``port -> topic`` (an output); several topics may stand there."""

    port: Name
    is_output: bool
    topics: tuple[Name, ...]


class NodeDeclaration(NamedTuple):
    span: Span
    name: Name
    component: Name | None
    attachments: tuple[Attachment, ...]
    parameters: tuple[ParameterEntry, ...]
    files: tuple[Name, ...]
    broken: bool


class NamespaceBlock(NamedTuple):
    span: Span
    name: Name
    items: tuple[Item, ...]


class ParameterFile(NamedTuple):
    """``parameters "nav2.yaml"`` outside of any component or node: for every role it has a section for."""

    span: Span
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


class Duration(NamedTuple):
    kind: Name
    seconds: Number


class TimingBlock(NamedTuple):
    span: Span
    durations: tuple[Duration, ...]


ConstraintStatement: TypeAlias = "KeepStatement | LimitStatement | OrderStatement"
Item: TypeAlias = (
    "IncludeStatement | ContractDeclaration | TopicDeclaration | ResourceDeclaration | EnvironmentBlock"
    " | ComponentDeclaration | NodeDeclaration | NamespaceBlock | ParameterFile | ConstraintStatement | TimingBlock"
)


@dataclass(frozen=True, slots=True)
class SourceLayout:
    """What the printer must know of the tokens beside their text, by index.

    ``statements``: the first token of each statement, with what separates it from one before it on its line.
    ``items``: the tokens that a comma stands before. ``blocks``: the opening brace of each block with its closing one
    (braces of value sets are none). ``marks``: tokens that stand under each other on adjacent lines, by kind of line.
    """

    statements: dict[int, str] = field(default_factory=dict)
    items: set[int] = field(default_factory=set)
    blocks: dict[int, int] = field(default_factory=dict)
    marks: dict[int, str] = field(default_factory=dict)


class File(NamedTuple):
    """A whole file. ``lost`` holds the words of the parts that could not be read: one of them may be a declaration."""

    tokens: Tokens
    layout: SourceLayout
    system: Name | None
    items: tuple[Item, ...]
    lost: frozenset[str]
