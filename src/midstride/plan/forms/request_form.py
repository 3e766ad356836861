"""The JSON form of a request for a change: what a client of the manager sends, and what `demo.json` has."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, ClassVar, Literal, TypeAlias

from midstride.codec.component_form import NamedComponentForm
from midstride.codec.form import Form, NonEmptyName, field
from midstride.codec.parameter import ValueForm, values_of
from midstride.codec.reading import decode, under
from midstride.codec.specification_form import NodeForm, SpecificationForm
from midstride.model.diagnostics import Problem
from midstride.model.name_checks import component_names, specification_names
from midstride.plan.request import PlanRequest

Strategy: TypeAlias = Literal["minimal", "paper", "quiesce", "stop"]
ReplacementForm: TypeAlias = Annotated[tuple[NonEmptyName, NonEmptyName], field("a replacement", "[node, component]")]


class NewNode(NodeForm, frozen=True, kw_only=True):
    """A node to add: its role, its component, and the topics its ports are attached to."""

    what: ClassVar[str] = "a new node"

    role: NonEmptyName


class ChangeRequest(Form, frozen=True):
    """A request for a change: single changes, or a whole specification (`to`) to change to."""

    what: ClassVar[str] = "a request"

    replace: Annotated[list[ReplacementForm], field("a list of replacements", "[node, component] pairs")] = []
    restart: Annotated[list[NonEmptyName], field("a list of nodes", "nodes to restart: each gets a new instance")] = []
    add: Annotated[list[NewNode], field("a list of new nodes", "nodes to add")] = []
    remove: Annotated[list[NonEmptyName], field("a list of nodes", "nodes to remove")] = []
    parameters: Annotated[
        dict[NonEmptyName, Annotated[dict[str, ValueForm], field("an object of values", min_length=1)]],
        field("an object of nodes", "values to set at run time, by node and parameter, and nothing else"),
    ] = {}
    to: SpecificationForm | None = None
    components: Annotated[
        list[NamedComponentForm], field("a list of components", "components that the specification does not have yet")
    ] = []
    strategy: Strategy = "minimal"
    detours: Annotated[
        bool, field("a boolean", "with `minimal`: nodes that stay may be moved, and roles have stand-ins meanwhile")
    ] = False
    declared_parameters: Annotated[
        bool, field("a boolean", "start with the declared values of parameters, not with those set at run time")
    ] = False
    with_other_nodes: Annotated[
        bool,
        field("a boolean", "also where other nodes end with a process that the change ends: else it is refused"),
    ] = False
    same_process: Annotated[
        bool,
        field("a boolean", "a replaced node of a container starts in the process that it is in, with the same code"),
    ] = False
    on: Annotated[
        dict[NonEmptyName, NonEmptyName],
        field("an object of hosts", "the host that a node is to run on, by node; `manager`: that of the manager"),
    ] = {}
    explain: Annotated[
        bool, field("a boolean", "for a plan that is only shown: what it would cost to keep what it degrades")
    ] = False

    def request(self) -> PlanRequest:
        """The request as the planners know it; names are not checked. Raises ValueError as the parts do."""
        return PlanRequest(
            replace=tuple(self.replace),
            restart=tuple(self.restart),
            add=tuple(form.node(form.role) for form in self.add),
            remove=tuple(self.remove),
            parameters=tuple((node, values_of(values)) for node, values in self.parameters.items()),
            to=None if self.to is None else self.to.specification(),
            components=tuple(form.declared() for form in self.components),
            strategy=self.strategy,
            detours=self.detours,
            declared_parameters=self.declared_parameters,
            with_other_nodes=self.with_other_nodes,
            same_process=self.same_process,
            explain=self.explain,
            on=tuple(self.on.items()),
        )


def decode_request(document: object) -> PlanRequest:
    """The request that a document states. Raises SpecificationError with every fault of form and of names in it."""
    return decode(document, ChangeRequest, ChangeRequest.request, request_names)


def request_names(request: PlanRequest) -> Iterable[Problem]:
    """The faults in the names of what a request declares."""
    if request.to is not None:
        yield from under("to", specification_names(request.to))
    for index, component in enumerate(request.components):
        yield from component_names(component, ("components", str(index)))
