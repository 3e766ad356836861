"""A request for a change: roles to replace, add and remove, or a whole specification to change to."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace

from immutables import Map

from midstride.errors import PlanRefused
from midstride.model.component import ComponentSpec, FunctionalityRef, ParameterValue
from midstride.model.diagnostics import Problem, suggestion, unknown_name
from midstride.model.hosts import MANAGER, host_in_words, host_of_word
from midstride.model.name_checks import missing_for_constraints
from midstride.model.specification import Node, Specification
from midstride.model.specification_checks import check, check_component, check_node, errors


@dataclass(frozen=True, slots=True)
class PlanRequest:
    """A request for a change. ``components`` are declarations that the specification does not have yet.

    A role in ``replace`` or ``restart`` gets a new instance, also of the same component: its program may have changed.
    ``restart`` may accompany a whole specification.
    With ``declared_parameters``, parameter values that were set at run time are not kept.
    ``with_other_nodes``: nodes that the change does not name, and that end with a process that it ends, are meant too.
    ``same_process``: a replaced node of a container starts in the process that it is in, with the code that this has
    loaded. ``detours``: the strategy ``minimal`` also tries to move nodes that stay, and stand-ins.
    ``explain``: a plan that is only shown says what it would cost to keep what it degrades.
    ``restore``: only raise these functionalities of instances, to these modes. ``parameters``: only set these values at
    run time, by role. ``on``: the host that a role is to run on, by the words for hosts; without another component, it
    moves. ``half_done``: roles of which a change that could not be rolled back has left two instances; one stays.
    """

    replace: tuple[tuple[str, str], ...] = ()
    restart: tuple[str, ...] = ()
    add: tuple[Node, ...] = ()
    remove: tuple[str, ...] = ()
    to: Specification | None = None
    components: tuple[ComponentSpec, ...] = ()
    strategy: str = "minimal"
    detours: bool = False
    declared_parameters: bool = False
    with_other_nodes: bool = False
    same_process: bool = False
    restore: tuple[tuple[FunctionalityRef, int], ...] = ()
    parameters: tuple[tuple[str, Map[str, ParameterValue]], ...] = ()
    explain: bool = False
    on: tuple[tuple[str, str], ...] = ()
    half_done: tuple[str, ...] = ()

    def target(self, specification: Specification) -> Specification:
        """The specification to change to. Raises PlanRefused for an unknown name or a malformed declaration."""
        if self.to is not None:
            if self.replace or self.add or self.remove or self.parameters or self.on:
                raise PlanRefused("give either a whole specification or single changes, not both")
            _well_formed(check(self.to))
            for role in self.restart:
                require("node", role, self.to.nodes)
            return self.to
        if self.restore:
            return specification
        if self.parameters:
            if self.roles():
                raise PlanRefused("parameters are set in a change of their own; give the other changes separately")
            for role, _ in self.parameters:
                require("node", role, specification.nodes)
            return specification
        if not self.roles():
            raise PlanRefused(
                "the request is empty: name nodes to replace, restart, add or remove, or give a specification"
            )
        named = [*self.remove, *self.replaced()]
        for index, role in enumerate(named):
            if role in named[:index]:
                raise PlanRefused(f"node {role} is named twice; name each node once")
        target = specification
        for component in self.components:
            _well_formed(check_component(component), f"component {component.name}: ")
            for resource in sorted(set(component.resource_usage) - set(target.resources)):
                raise PlanRefused(
                    f"component {component.name} holds `{resource}`, a resource that the system does not declare; "
                    "use `apply` with a specification that declares it"
                )
            known = target.components.get(component.name)
            if known is not None and known != component:
                raise PlanRefused(f"component {component.name} is already declared differently; give it another name")
            target = replace(target, components=target.components.set(component.name, component))
        for role in self.remove:
            require("node", role, target.nodes)
            target = target.without_node(role)
        for role in (*self.restart, *self.half_done):
            require("node", role, target.nodes)
        for role, name in self.replace:
            require("node", role, target.nodes)
            require("component", name, target.components)
            target = _replaced(target, role, name)
        for role, word in self.on:
            require("node", role, target.nodes)
            target = _on_host(target, role, word, moves=role in self.moved())
        for node in self.add:
            if node.role in target.nodes:
                raise PlanRefused(f"node {node.role} already exists; replace it, or choose another name")
            target = target.with_node(node)
        for role in dict.fromkeys(
            (*(role for role, _ in (*self.replace, *self.on)), *(node.role for node in self.add))
        ):
            # Whether the contracts fit is checked by the change itself, for the instances concerned.
            _well_formed(problem for problem in check_node(target, role) if problem.code != "E020")
        return target

    def for_members(self, specification: Specification) -> PlanRequest:
        """The request with the nodes of each container that it names to restart or to remove, instead of its name.

        Raises PlanRefused where a container has none, and where a name is that of neither.
        """

        def members(name: str) -> list[str]:
            if name not in specification.containers:
                if specification.containers:
                    require("node or container", name, {*specification.nodes, *specification.containers})
                return [name]
            if not (found := specification.members_of(name)):
                raise PlanRefused(f"container {name} has no node; `in {name}` puts one into it")
            return found

        def named(names: tuple[str, ...]) -> tuple[str, ...]:
            return tuple(role for name in names for role in members(name))

        return replace(self, restart=named(self.restart), remove=named(self.remove))

    def together(self, specification: Specification) -> set[str]:
        """The roles of the containers that it names to restart: all of them share one process afterwards."""
        named = (name for name in self.restart if name in specification.containers)
        return {role for name in named for role in specification.members_of(name)}

    def for_roles(self, role_of: Mapping[str, str]) -> PlanRequest:
        """The request with the role of each instance that it names (``role_of`` has them): a request is for roles."""

        def role(name: str) -> str:
            return role_of.get(name, name)

        return replace(
            self,
            replace=tuple((role(name), component) for name, component in self.replace),
            restart=tuple(map(role, self.restart)),
            remove=tuple(map(role, self.remove)),
            parameters=tuple((role(name), values) for name, values in self.parameters),
            on=tuple((role(name), host) for name, host in self.on),
        )

    def roles(self) -> list[str]:
        """The roles that are named."""
        return [*self.remove, *self.replaced(), *(node.role for node in self.add), *self.half_done]

    def renewed(self, target: Specification) -> list[str]:
        """The roles of ``target`` that get a new instance in any case: where everything is stopped, all that run."""
        if not self.stops_everything:
            return self.replaced()
        return sorted({*self.replaced(), *(role for role in target.nodes if not target.component_of(role).once)})

    def stays_away(self, role: str, specification: Specification) -> bool:
        """Return whether a node that has crashed is none of the request's business.

        It is asked for by its name, by a change of what the specification says of it, and by the specification that
        runs already.
        """
        if self.stops_everything or role in self.roles():
            return False
        if self.to is None:
            return True
        if self.to == specification or role not in self.to.nodes:
            return False
        before, after = ((each.nodes[role], each.component_of(role)) for each in (specification, self.to))
        return before == after

    @property
    def stops_everything(self) -> bool:
        """Return whether every role is concerned, named or not."""
        return self.strategy == "stop"

    def replaced(self) -> list[str]:
        """The roles that are named to get a new instance."""
        return [*self.restart, *(role for role, _ in self.replace), *self.moved()]

    def moved(self) -> list[str]:
        """The roles that get a new instance for the sake of another host alone."""
        named = {*self.restart, *(role for role, _ in self.replace)}
        return [role for role, _ in self.on if role not in named]

    def describe(self) -> str:
        """The change in the words of the commands that ask for it."""
        words = [f"remove {role}" for role in self.remove]
        words += [f"restart {role}" for role in self.restart]
        hosts = dict(self.on)
        words += [
            f"replace {role} with {component}{f' on {hosts[role]}' if role in hosts else ''}"
            for role, component in self.replace
        ]
        words += [f"move {role} to {hosts[role]}" for role in self.moved()]
        words += [f"add {node.role} ({node.component})" for node in self.add]
        words += [f"roll back {role}" for role in self.half_done]
        if self.to is not None:
            words.append(f"apply {self.to.name}")
        settings = [
            f"{role}.{name} = {value!r}" for role, values in self.parameters for name, value in sorted(values.items())
        ]
        if settings:
            words.append(f"set {', '.join(settings)}")
        if self.restore:
            words.append(f"restore {', '.join(str(ref) for ref, _ in self.restore)}")
        return ", ".join(words) or "nothing"


def _well_formed(problems: Iterable[Problem], of: str = "") -> None:
    if found := errors(problems):
        raise PlanRefused("; ".join(f"{of}{problem}" for problem in found))


def require(kind: str, name: str, known: Collection[str]) -> None:
    """Raises PlanRefused, with a suggestion, where ``name`` is not known."""
    if name not in known:
        hint = suggestion(name, known)
        raise PlanRefused(unknown_name(kind, name) + (f"; {hint}" if hint else ""))


def _replaced(target: Specification, role: str, name: str) -> Specification:
    node, component = target.nodes[role], target.components[name]
    missing = sorted(set(node.attachments) - set(component.ports()))
    if missing:
        ports_on = ", ".join(f"{port} (on {', '.join(node.attachments[port])})" for port in missing)
        raise PlanRefused(
            f"{name} cannot replace {role}: it has no port {ports_on}; use `apply` with a changed specification"
        )
    target = target.with_replaced(role, name)
    if missing := missing_for_constraints(target, role):
        raise PlanRefused(
            f"{name} cannot replace {role}: {'; '.join(missing)}; "
            "use `apply` with a specification without that constraint"
        )
    return target


def _on_host(target: Specification, role: str, word: str, *, moves: bool) -> Specification:
    """``target`` with the node on the host of that word; ``moves``: that is all that is asked for."""
    require("host", word, {*target.hosts, MANAGER})
    node, host = target.nodes[role], host_of_word(word)
    if node.container is not None and node.host != host:
        raise PlanRefused(
            f"{role} is loaded by container {node.container}, which is on {host_in_words(node.host)}, and moves with "
            f"it: use `apply` with a specification that has the container on {word}"
        )
    if moves and node.host == host:
        raise PlanRefused(
            f"{role} is on {host_in_words(host)} already; `midstride restart {role}` starts it again there"
        )
    return target.with_node(replace(node, host=host))
