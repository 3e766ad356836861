"""The plan that sets parameters of running nodes at run time, and changes nothing else."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from immutables import Map

from midstride.errors import PlanRefused
from midstride.model.action import SetParameters
from midstride.model.component import ParameterValue, same_value, value_fits, value_kind
from midstride.model.configuration import Configuration
from midstride.model.diagnostics import suggestion
from midstride.model.specification import Specification
from midstride.plan.change import Change
from midstride.plan.disruption import Levels
from midstride.plan.estimate import Estimate
from midstride.plan.plan import Plan
from midstride.plan.runtime_values import RuntimeValue, Values, setting
from midstride.plan.strategies.plan_builder import PlanBuilder


def set_parameters(
    configuration: Configuration,
    specification: Specification,
    asked: Sequence[tuple[str, Values]],
    known: Mapping[str, Values],
    measured: Mapping[str, Estimate],
) -> Plan:
    """The steps that set the values ``asked`` for, by role; ``known`` are those that the instances have, by name.

    What a node has already is not set. Raises PlanRefused with each parameter that a node does not have, and each value
    of another type than it has: no node is asked then.
    """
    change = Change.none(specification, configuration, measured)
    instances = {each.role: each.name for each in configuration.instances.values() if each.name in known}
    if faults := [fault for role, values in asked for fault in _faults(role, values, known[instances[role]])]:
        raise PlanRefused("; ".join(faults))
    actions: list[SetParameters] = []
    listed: list[RuntimeValue] = []
    for role, values in asked:
        have = known[instances[role]]
        wanted = {name: _fitted(value, have[name]) for name, value in values.items()}
        changed = {name: value for name, value in wanted.items() if not same_value(value, have[name])}
        if changed:
            before = Map({name: have[name] for name in changed})
            actions.append(SetParameters(instances[role], Map(changed), before))
            listed += [
                setting(role, name, value, "set", f"it is {have[name]!r} now") for name, value in changed.items()
            ]
    levels = Levels(change)
    plan = Plan.of("minimal", PlanBuilder.at_start(levels).do(*actions).steps, levels)
    return replace(plan, parameters=tuple(listed))


def _faults(role: str, values: Values, have: Values) -> Iterator[str]:
    for name, value in values.items():
        if name not in have:
            hint = suggestion(name, have)
            yield f"{role} has no parameter {name}" + (f"; {hint}" if hint else "")
        elif not value_fits(value, have[name]):
            yield f"{name} of {role} is {value_kind(have[name])} ({have[name]!r}), and {value!r} is {value_kind(value)}"


def _fitted(value: ParameterValue, like: ParameterValue) -> ParameterValue:
    """An integer as a float where the node has one."""
    if isinstance(value, list) and isinstance(like, list) and like:
        return [_fitted(member, like[0]) for member in value]  # type: ignore[return-value]
    return float(value) if isinstance(like, float) and isinstance(value, int) else value
