"""The reconfiguration actions: what can be done to a running system, one small step at a time.

Create and remove components, attach and detach their ports, degrade and upgrade their functionalities, hand a
topic over from one output to another, set parameters. An action is a value: ``check`` lists the preconditions that
fail, ``apply`` yields the next configuration or refuses with that list, ``undo(before)`` is a short valid sequence
that leads back to ``before``. Every action takes a valid configuration to a valid one, so a system that is changed
by actions alone is valid all the way (docs/semantics.md section 4; the paper's section 4.3). The cost of an action
follows the neighbourhood of what it touches, not the size of the system.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Literal

from immutables import Map

from midstride.errors import ActionRefused
from midstride.model import wording
from midstride.model.best import consumers_of
from midstride.model.component import Connector, FunctionalityRef, ParameterValue, PortRef, value_fits, value_kind
from midstride.model.configuration import Configuration, Instance
from midstride.model.contract import explain, satisfies
from midstride.model.rules import Evaluator, attachment_shortfall, cap_violation, capacity_violation


@dataclass(frozen=True, slots=True)
class Reason:
    """One failed precondition. ``subjects`` are the ports, functionalities, topics or resources in question."""

    precondition: str
    subjects: tuple[str, ...]
    because: str

    def __str__(self) -> str:
        return self.because


@dataclass(frozen=True, slots=True)
class Swap:
    """One exchange of a hand-over: on ``connector``, output ``new`` takes over from ``old``."""

    connector: str
    old: PortRef
    new: PortRef

    def __str__(self) -> str:
        return wording.swap(self.connector, str(self.old), str(self.new))


class Action(ABC):
    """The interface of every action. Actions are frozen values."""

    __slots__ = ()
    kind: ClassVar[str]
    is_structural: ClassVar[bool] = True
    """Whether it changes what is live or attached, rather than modes or parameters."""

    @abstractmethod
    def instances(self) -> tuple[str, ...]:
        """The instances that the action changes, in a stable order."""

    @abstractmethod
    def check(self, configuration: Configuration) -> tuple[Reason, ...]:
        """The preconditions that fail in ``configuration``; empty iff the action is allowed. Changes nothing."""

    @abstractmethod
    def effect(self, configuration: Configuration) -> Configuration:
        """The configuration after the action, whether or not its precondition holds."""

    @abstractmethod
    def undo(self, before: Configuration) -> tuple[Action, ...]:
        """The actions that take ``apply(before)`` back to ``before``, each of them valid."""

    @abstractmethod
    def describe(self, configuration: Configuration | None = None) -> str:
        """The action in words; modes appear by name where the configuration before the action is given."""

    def apply(self, configuration: Configuration) -> Configuration:
        """The configuration after the action. Raises ActionRefused where the precondition fails."""
        if reasons := self.check(configuration):
            raise ActionRefused(self.describe(configuration), reasons)
        return self.effect(configuration)

    def __str__(self) -> str:
        return self.describe()


@dataclass(frozen=True, slots=True)
class Create(Action):
    """``create c``: live, isolated, every functionality in its last mode."""

    kind: ClassVar[str] = "create"
    instance: Instance

    def instances(self) -> tuple[str, ...]:
        return (self.instance.name,)

    def check(self, configuration: Configuration) -> tuple[Reason, ...]:
        name = self.instance.name
        if name in configuration.instances:
            return (Reason("not live", (name,), f"{name} is already live"),)
        after = self.effect(configuration)
        return tuple(
            Reason("capacity", (resource,), str(violation))
            for resource in sorted(self.instance.resource_usage)
            if (violation := capacity_violation(after, resource)) is not None
        )

    def effect(self, configuration: Configuration) -> Configuration:
        return configuration.with_instance(self.instance)

    def undo(self, before: Configuration) -> tuple[Action, ...]:
        return (Remove(self.instance.name),)

    def describe(self, configuration: Configuration | None = None) -> str:
        return wording.existence(self.kind, self.instance.name, self.instance.component.name, self.instance.host)


@dataclass(frozen=True, slots=True)
class Remove(Action):
    """``remove c``: a live and isolated component, in whatever modes, is no longer live."""

    kind: ClassVar[str] = "remove"
    instance: str

    def instances(self) -> tuple[str, ...]:
        return (self.instance,)

    def check(self, configuration: Configuration) -> tuple[Reason, ...]:
        if self.instance not in configuration.instances:
            return (Reason("live", (self.instance,), f"{self.instance} is not live"),)
        return tuple(
            Reason("isolated", (str(port), connector), f"{port} is still attached to {connector}")
            for port, connector in configuration.attached_ports(self.instance)
        )

    def effect(self, configuration: Configuration) -> Configuration:
        return configuration.without_instance(self.instance)

    def undo(self, before: Configuration) -> tuple[Action, ...]:
        instance = before.instances[self.instance]
        raised = [
            Upgrade(Map({ref: before.modes[ref]}))
            for ref in instance.functionality_refs()
            if before.modes[ref] != before.functionality(ref).last_mode
        ]
        return (Create(instance), *raised)

    def describe(self, configuration: Configuration | None = None) -> str:
        return wording.existence(self.kind, self.instance)


def _port_reasons(configuration: Configuration, port: PortRef, connector: str) -> tuple[Reason, ...]:
    if port.instance not in configuration.instances:
        return (Reason("live", (port.instance,), f"{port.instance} is not live"),)
    if not configuration.has_port(port):
        return (Reason("port", (str(port),), f"{port.instance} has no port {port.port}"),)
    if connector not in configuration.context.connectors:
        kind = wording.KIND_WORDS[configuration.component(port.instance).kind_of(port.port)].connector
        because = f"{connector} is not {wording.indefinite(kind)} of this system"
        return (Reason("topic", (connector,), because),)
    return ()


@dataclass(frozen=True, slots=True)
class _AttachmentAction(Action):
    """The common part of attaching and detaching."""

    port: PortRef
    connector: str

    def instances(self) -> tuple[str, ...]:
        return (self.port.instance,)

    def describe(self, configuration: Configuration | None = None) -> str:
        return wording.attachment(self.kind, str(self.port), self.connector)


@dataclass(frozen=True, slots=True)
class Attach(_AttachmentAction):
    """``attach p k``: the normal mode of an output, or the topic of an input, must satisfy the other side."""

    kind: ClassVar[str] = "attach"

    def check(self, configuration: Configuration) -> tuple[Reason, ...]:
        if reasons := _port_reasons(configuration, self.port, self.connector):
            return reasons
        port, name = str(self.port), self.connector
        if configuration.is_attached(self.port, name):
            return (Reason("not attached", (port, name), f"{port} is already attached to {name}"),)
        reasons = contract_reasons(configuration, self.port, configuration.context.connectors[name])
        if reasons or not configuration.is_output(self.port):
            return reasons
        violation = cap_violation(self.effect(configuration), name)
        return () if violation is None else (Reason("cap", (port, name), str(violation)),)

    def effect(self, configuration: Configuration) -> Configuration:
        return configuration.with_attachment(self.port, self.connector)

    def undo(self, before: Configuration) -> tuple[Action, ...]:
        return (Detach(self.port, self.connector),)


def contract_reasons(configuration: Configuration, port: PortRef, connector: Connector) -> tuple[Reason, ...]:
    """The reasons why the contracts of a live port and a connector do not fit, clause by clause; empty iff they do."""
    shortfall, clauses = attachment_shortfall(configuration.component(port.instance), port, connector)
    if not clauses:
        return ()
    return (Reason("contract", (str(port), connector.name), f"{shortfall} ({', '.join(clauses)})"),)


@dataclass(frozen=True, slots=True)
class Detach(_AttachmentAction):
    """``detach p k``: every functionality must stay satisfied without the attachment."""

    kind: ClassVar[str] = "detach"

    def check(self, configuration: Configuration) -> tuple[Reason, ...]:
        if reasons := _port_reasons(configuration, self.port, self.connector):
            return reasons
        if not configuration.is_attached(self.port, self.connector):
            because = f"{self.port} is not attached to {self.connector}"
            return (Reason("attached", (str(self.port), self.connector), because),)
        after = self.effect(configuration)
        if configuration.is_output(self.port) and Evaluator(after).connector_satisfied(self.connector):
            return ()  # while another publisher satisfies the topic, no consumer loses anything
        affected = consumers_of(configuration, self.port, self.connector)
        return _unsatisfied(after, affected, str(self.port), self.connector)

    def effect(self, configuration: Configuration) -> Configuration:
        return configuration.without_attachment(self.port, self.connector)

    def undo(self, before: Configuration) -> tuple[Action, ...]:
        return (Attach(self.port, self.connector),)


def _unsatisfied(after: Configuration, refs: Iterable[FunctionalityRef], *others: str) -> tuple[Reason, ...]:
    """One reason for each assumption of ``refs`` that would not hold; ``others`` are further subjects."""
    return tuple(
        Reason(
            "satisfied",
            tuple(dict.fromkeys((*violation.names, *others))),
            f"{violation.subject} would be unsatisfied: it {violation.because}",
        )
        for violation in Evaluator(after).violations_of(refs)
    )


def _mode_reasons(
    configuration: Configuration, modes: Mapping[FunctionalityRef, int], direction: Literal["better", "worse"]
) -> Iterator[Reason]:
    if not modes:
        yield Reason("named", (), "no functionality is given")
    for ref, index in sorted(modes.items()):
        functionality = configuration.find_functionality(ref)
        if functionality is None:
            yield Reason("live", (str(ref),), f"{ref} is not a functionality of a live component")
        elif not 0 <= index <= functionality.last_mode:
            yield Reason("mode", (str(ref),), f"{ref} has no mode number {index}")
        elif not (index < configuration.modes[ref] if direction == "better" else index > configuration.modes[ref]):
            now, then = functionality.modes[configuration.modes[ref]].name, functionality.modes[index].name
            yield Reason("mode", (str(ref),), f"mode {then} of {ref} is not {direction} than its current mode, {now}")


def _mode_names(
    modes: Mapping[FunctionalityRef, int], configuration: Configuration | None
) -> Iterator[tuple[str, str | None, str]]:
    """Each functionality with the mode it leaves, where that is known, and the mode it enters."""
    for ref, index in sorted(modes.items()):
        functionality = None if configuration is None else configuration.find_functionality(ref)
        if configuration is None or functionality is None or not 0 <= index <= functionality.last_mode:
            yield str(ref), None, f"mode {index}"
        else:
            yield str(ref), configuration.mode(ref).name, functionality.modes[index].name


@dataclass(frozen=True, slots=True)
class _ModeAction(Action):
    """The common part of degrading and upgrading: the functionalities, each with the mode that it enters."""

    is_structural: ClassVar[bool] = False
    modes: Map[FunctionalityRef, int]

    def instances(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(ref.instance for ref in sorted(self.modes)))

    def effect(self, configuration: Configuration) -> Configuration:
        return configuration.with_modes(self.modes)

    def describe(self, configuration: Configuration | None = None) -> str:
        return wording.mode_changes(self.kind, _mode_names(self.modes, configuration))


@dataclass(frozen=True, slots=True)
class Degrade(_ModeAction):
    """``degrade F``: to strictly worse modes. F in its new modes, and every other functionality, stays satisfied."""

    kind: ClassVar[str] = "degrade"

    def check(self, configuration: Configuration) -> tuple[Reason, ...]:
        if reasons := tuple(_mode_reasons(configuration, self.modes, "worse")):
            return reasons
        after = self.effect(configuration)
        now, was = Evaluator(after), Evaluator(configuration)
        affected: dict[FunctionalityRef, None] = dict.fromkeys(self.modes)
        for ref in self.modes:
            for _, name in configuration.published(ref):
                if was.connector_satisfied(name) and not now.connector_satisfied(name):
                    affected.update(dict.fromkeys(configuration.consumers(name)))
        return _unsatisfied(after, affected)

    def undo(self, before: Configuration) -> tuple[Action, ...]:
        return (Upgrade(Map({ref: before.modes[ref] for ref in self.modes})),)


@dataclass(frozen=True, slots=True)
class Upgrade(_ModeAction):
    """``upgrade F``: to strictly better modes, in which each of F is satisfied afterwards."""

    kind: ClassVar[str] = "upgrade"

    def check(self, configuration: Configuration) -> tuple[Reason, ...]:
        reasons = tuple(_mode_reasons(configuration, self.modes, "better"))
        return reasons or _unsatisfied(self.effect(configuration), self.modes)

    def undo(self, before: Configuration) -> tuple[Action, ...]:
        return (Degrade(Map({ref: before.modes[ref] for ref in self.modes})),)


@dataclass(frozen=True, slots=True)
class Handover(Action):
    """``handover``: on each connector ``new`` takes over from ``old``, all in one step."""

    kind: ClassVar[str] = "handover"
    swaps: tuple[Swap, ...]

    def instances(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(port.instance for swap in self.swaps for port in (swap.old, swap.new)))

    def check(self, configuration: Configuration) -> tuple[Reason, ...]:
        if not self.swaps:
            return (Reason("named", (), "no swap is given"),)
        reasons = [reason for swap in self.swaps for reason in _swap_reasons(configuration, swap)]
        seen: set[tuple[PortRef, str]] = set()
        for end in ((port, swap.connector) for swap in self.swaps for port in (swap.old, swap.new)):
            if end in seen:
                reasons.append(Reason("once", (str(end[0]), end[1]), f"{end[0]} occurs twice on {end[1]}"))
            seen.add(end)
        if not reasons:
            after = self.effect(configuration)
            for name in sorted({swap.connector for swap in self.swaps}):
                if (violation := cap_violation(after, name)) is not None:
                    reasons.append(Reason("cap", (name,), str(violation)))
        return tuple(reasons)

    def effect(self, configuration: Configuration) -> Configuration:
        for swap in self.swaps:
            configuration = configuration.with_attachment(swap.new, swap.connector)
        for swap in self.swaps:
            configuration = configuration.without_attachment(swap.old, swap.connector)
        return configuration

    def undo(self, before: Configuration) -> tuple[Action, ...]:
        back: list[Swap] = []
        separate: list[Action] = []
        for swap in self.swaps:
            if satisfies(before.guarantee(swap.old), before.context.connectors[swap.connector].guarantee):
                back.append(Swap(swap.connector, swap.new, swap.old))
            else:
                separate += [Detach(swap.new, swap.connector), Attach(swap.old, swap.connector)]
        return (*([Handover(tuple(back))] if back else []), *separate)

    def describe(self, configuration: Configuration | None = None) -> str:
        return wording.handover((swap.connector, str(swap.old), str(swap.new)) for swap in self.swaps)


def _swap_reasons(configuration: Configuration, swap: Swap) -> Iterator[Reason]:
    for port in (swap.old, swap.new):
        if reasons := _port_reasons(configuration, port, swap.connector):
            yield from reasons
            return
        if not configuration.is_output(port):
            yield Reason("output", (str(port),), f"{port} is not an output")
            return
    subjects = (str(swap.old), str(swap.new), swap.connector)
    if not configuration.is_attached(swap.old, swap.connector):
        yield Reason("old attached", subjects, f"{swap.old} is not attached to {swap.connector}")
    if configuration.is_attached(swap.new, swap.connector):
        yield Reason("new not attached", subjects, f"{swap.new} is already attached to {swap.connector}")
    guarantee = configuration.guarantee(swap.new)
    if clauses := explain(guarantee, configuration.context.connectors[swap.connector].guarantee):
        because = f"{swap.new} in its current mode does not satisfy {swap.connector} ({', '.join(clauses)})"
        yield Reason("contract", subjects, because)


@dataclass(frozen=True, slots=True)
class SetParameters(Action):
    """``set``: parameters of a live component, in place; it affects nothing else (section 6).

    They are changeable, and the values are the specification's. With ``before``, the values that the node has, they are
    set at run time: the specification stays as it is, and the node accepts them or not.
    """

    kind: ClassVar[str] = "set"
    is_structural: ClassVar[bool] = False
    instance: str
    parameters: Map[str, ParameterValue] = field(default_factory=Map)
    before: Map[str, ParameterValue] | None = None

    def instances(self) -> tuple[str, ...]:
        return (self.instance,)

    def check(self, configuration: Configuration) -> tuple[Reason, ...]:
        instance = configuration.instances.get(self.instance)
        if instance is None:
            return (Reason("live", (self.instance,), f"{self.instance} is not live"),)
        if self.before is not None:
            return ()
        reasons = []
        for name, value in sorted(self.parameters.items()):
            declared, subjects = instance.component.parameters.get(name), (f"{self.instance}.{name}",)
            if declared is None:
                reasons.append(Reason("parameter", subjects, f"{self.instance} has no parameter {name}"))
            elif not declared.changeable:
                because = f"parameter {name} of {self.instance} is not changeable; replace the node instead"
                reasons.append(Reason("changeable", subjects, because))
            elif not value_fits(value, declared.value):
                takes = f"takes {value_kind(declared.value)}, not {value_kind(value)}"
                reasons.append(Reason("type", subjects, f"parameter {name} of {self.instance} {takes}"))
        return tuple(reasons)

    def effect(self, configuration: Configuration) -> Configuration:
        if self.before is not None:
            return configuration
        return configuration.with_parameters(self.instance, self.parameters)

    def undo(self, before: Configuration) -> tuple[Action, ...]:
        if self.before is not None:
            return (SetParameters(self.instance, self.before, self.parameters),)
        old = {name: before.instances[self.instance].parameters[name] for name in self.parameters}
        return (SetParameters(self.instance, Map(old)),)

    def describe(self, configuration: Configuration | None = None) -> str:
        return wording.parameters(self.instance, self.parameters)
