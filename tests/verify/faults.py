"""Faults planted in the model's actions: one way each in which a check or an effect may be wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import pytest
from immutables import Map

from midstride.model import action as model
from midstride.model import rules
from midstride.model.component import ComponentSpec, PortRef
from midstride.model.configuration import Configuration
from midstride.model.contract import Contract, satisfies
from midstride.model.rules import Evaluator
from tests.planting import plant

Plant = Callable[[pytest.MonkeyPatch], None]


@dataclass(frozen=True, slots=True)
class Fault:
    """``plant`` breaks the action ``kind``; ``message`` is part of the expected disagreement."""

    name: str
    kind: str
    plant: Plant
    message: str


def _nothing(*_: object, **__: object) -> None:
    """Finds nothing wrong."""


def _create_forgets_capacities(patch: pytest.MonkeyPatch) -> None:
    plant(patch, model, "capacity_violation", _nothing)


def _create_starts_in_the_normal_mode(patch: pytest.MonkeyPatch) -> None:
    def effect(self: model.Create, configuration: Configuration) -> Configuration:
        after = configuration.with_instance(self.instance)
        return after.with_modes(dict.fromkeys(self.instance.functionality_refs(), 0))

    plant(patch, model.Create, "effect", effect)


def _remove_forgets_attachments(patch: pytest.MonkeyPatch) -> None:
    plant(patch, Configuration, "attached_ports", lambda *_, **__: ())


def _attach_judges_by_the_last_mode(patch: pytest.MonkeyPatch) -> None:
    def last(component: ComponentSpec, output: str) -> Contract:
        return component.owner(output).modes[-1].guarantee(output)

    plant(patch, rules, "normal_guarantee", last)


def _attach_forgets_the_cap(patch: pytest.MonkeyPatch) -> None:
    plant(patch, model, "cap_violation", _nothing)


def _attach_forgets_what_was_attached(patch: pytest.MonkeyPatch) -> None:
    """An input moves from topic to topic instead of having several."""

    def effect(self: model.Attach, configuration: Configuration) -> Configuration:
        for connector in configuration.attached_to(self.port):
            configuration = configuration.without_attachment(self.port, connector)
        return configuration.with_attachment(self.port, self.connector)

    plant(patch, model.Attach, "effect", effect)


def _detach_checks_nothing(patch: pytest.MonkeyPatch) -> None:
    plant(patch, Configuration, "consumers", lambda *_, **__: ())


def _degrade_checks_only_the_degraded(patch: pytest.MonkeyPatch) -> None:
    def check(self: model.Degrade, configuration: Configuration) -> tuple[model.Reason, ...]:
        reasons = tuple(model._mode_reasons(configuration, self.modes, "worse"))
        return reasons or model._unsatisfied(self.effect(configuration), self.modes, "then")

    plant(patch, model.Degrade, "check", check)


def _degrade_goes_all_the_way(patch: pytest.MonkeyPatch) -> None:
    def effect(self: model.Degrade, configuration: Configuration) -> Configuration:
        return configuration.with_modes({ref: configuration.functionality(ref).last_mode for ref in self.modes})

    plant(patch, model.Degrade, "effect", effect)


def _upgrade_judges_the_mode_it_leaves(patch: pytest.MonkeyPatch) -> None:
    def check(self: model.Upgrade, configuration: Configuration) -> tuple[model.Reason, ...]:
        reasons = tuple(model._mode_reasons(configuration, self.modes, "better"))
        return reasons or model._unsatisfied(configuration, self.modes, "before")

    plant(patch, model.Upgrade, "check", check)


def _upgrade_checks_one_by_one(patch: pytest.MonkeyPatch) -> None:
    """A group that only works together is refused."""

    def check(self: model.Upgrade, configuration: Configuration) -> tuple[model.Reason, ...]:
        if reasons := tuple(model._mode_reasons(configuration, self.modes, "better")):
            return reasons
        alone = [
            model._unsatisfied(configuration.with_modes(Map({ref: mode})), [ref], "")
            for ref, mode in self.modes.items()
        ]
        return tuple(reason for reasons in alone for reason in reasons)

    plant(patch, model.Upgrade, "check", check)


def _handover_judges_by_the_normal_mode(patch: pytest.MonkeyPatch) -> None:
    def guarantee(self: Configuration, output: PortRef) -> Contract:
        component = self.component(output.instance)
        return component.owner(output.port).modes[0].guarantee(output.port)

    plant(patch, Configuration, "guarantee", guarantee)


def _handover_keeps_the_old(patch: pytest.MonkeyPatch) -> None:
    def effect(self: model.Handover, configuration: Configuration) -> Configuration:
        for swap in self.swaps:
            configuration = configuration.with_attachment(swap.new, swap.connector)
        return configuration

    plant(patch, model.Handover, "effect", effect)


def _names_are_predicates(patch: pytest.MonkeyPatch) -> None:
    """An assumption that names one input is satisfied by any other of the functionality's."""
    whole = Evaluator.input_satisfied

    def any_input(self: Evaluator, port: PortRef) -> bool:
        others = {
            name for f in self.configuration.component(port.instance) if port.port in f.inputs for name in f.inputs
        }
        return any(whole(self, PortRef(port.instance, name)) for name in others)

    plant(patch, Evaluator, "input_satisfied", any_input)


def _the_environment_counts_for_nothing(patch: pytest.MonkeyPatch) -> None:
    """A publisher out of scope does not satisfy its topic."""

    def satisfied(self: Evaluator, name: str) -> bool:
        needed = self.configuration.context.connectors[name].guarantee
        return any(satisfies(self.guarantee(output), needed) for output in self.configuration.publishers_on(name))

    plant(patch, Evaluator, "connector_satisfied", satisfied)


_ALLOWS, _REFUSES = "the code allows it, the specification refuses it", "the specification allows it"
_ELSEWHERE = "the specification says that it leads elsewhere"

FAULTS: Final = (
    Fault(
        "capacities are forgotten", "create", _create_forgets_capacities, f"{_ALLOWS} (a resource would be exceeded)"
    ),
    Fault("it starts in its normal mode", "create", _create_starts_in_the_normal_mode, _ELSEWHERE),
    Fault("attachments are forgotten", "remove", _remove_forgets_attachments, f"{_ALLOWS} ("),
    Fault("judged by the last mode", "attach", _attach_judges_by_the_last_mode, _REFUSES),
    Fault("the cap is forgotten", "attach", _attach_forgets_the_cap, f"{_ALLOWS} (the cap on publishers would be"),
    Fault("other topics are left", "attach", _attach_forgets_what_was_attached, _ELSEWHERE),
    Fault("no consumer is checked", "detach", _detach_checks_nothing, "would lack"),
    Fault("only the degraded are checked", "degrade", _degrade_checks_only_the_degraded, "would lack"),
    Fault("all the way down", "degrade", _degrade_goes_all_the_way, _ELSEWHERE),
    Fault("the old mode is judged", "upgrade", _upgrade_judges_the_mode_it_leaves, "would lack"),
    Fault("each alone is judged", "upgrade", _upgrade_checks_one_by_one, _REFUSES),
    Fault("the normal mode is judged", "handover", _handover_judges_by_the_normal_mode, "does not satisfy the topic"),
    Fault("the old stays", "handover", _handover_keeps_the_old, _ELSEWHERE),
    Fault("a name is a predicate", "upgrade", _names_are_predicates, "would lack"),
    Fault("publishers out of scope are forgotten", "upgrade", _the_environment_counts_for_nothing, _REFUSES),
)
