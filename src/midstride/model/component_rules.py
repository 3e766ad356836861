"""Checks of a single component, predicate or number (docs/semantics.md sections 1 and 2).

Part of :mod:`midstride.model.specification_checks`. Names without a declaration are skipped here.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Final

from midstride.model.component import (
    DEFAULT_STOP,
    ComponentSpec,
    ContainerProgram,
    FunctionalitySpec,
    InputAlternatives,
    Mode,
    ParameterValue,
    StopTimes,
)
from midstride.model.contract import BOUND_WORDS, DEFAULT_QOS, OneOf, Predicate, QoS, explain, format_number
from midstride.model.diagnostics import Problem, SubjectPath
from midstride.model.wording import KIND_WORDS, indefinite

# The largest number that a specification may state, in base units and of either sign; parameters are ROS's to limit.
MAX_NUMBER: Final = 1e18
MAX_DEPTH: Final = 2**31 - 1
_INT64: Final = 2**63


def number_problems(
    value: float | None, what: str, path: SubjectPath, *, zero: bool = False, most: float = MAX_NUMBER
) -> Iterator[Problem]:
    """``value``, where stated, must be finite, positive (or zero, where that has a meaning) and at most ``most``."""
    if value is None:
        return
    if not (math.isfinite(value) and (value > 0 or (zero and value == 0))):
        least = "at least" if zero else "greater than"
        yield Problem("E004", path, f"{what} must be finite and {least} 0, but is {format_number(value)}")
    elif value > most:
        message = f"{what} must be at most {format_number(most)}, but is {format_number(value)}"
        yield Problem("E004", path, message, f"write at most {format_number(most)}")


def container_rules(program: ContainerProgram, path: SubjectPath) -> Iterator[Problem]:
    """The numbers of a container that several nodes share, which has no requests or goals of its own."""
    yield from number_problems(program.startup_seconds, "a start-up time", (*path, "takes_seconds"), zero=True)
    if (stop := program.stop) is not None:
        yield from _ends(stop, path)
        for name, stated in (("drain", stop.drain), ("patience", stop.patience)):
            if stated != getattr(DEFAULT_STOP, name):
                message = f"a container states `{name}`, and only its nodes have requests and goals"
                yield Problem("E027", (*path, "stop_seconds", name), message, "state it for their components")


def _ends(stop: StopTimes, path: SubjectPath) -> Iterator[Problem]:
    for name, seconds in (("sigterm", stop.sigterm), ("sigkill", stop.sigkill)):
        what = f"a time until {name.upper()}"
        yield from number_problems(seconds, what, (*path, "stop_seconds", name), zero=True)


def value_problems(value: ParameterValue, path: SubjectPath) -> Iterator[Problem]:
    """The value of a parameter must be one that ROS has."""
    members = value if isinstance(value, (list, tuple)) else [value]
    if any(isinstance(member, int) and not -_INT64 <= member < _INT64 for member in members):
        yield Problem("E004", path, "integer parameters have at most 64 bits", "write a real number, such as 1e20")


def predicate_problems(predicate: Predicate, path: SubjectPath) -> Iterator[Problem]:
    """A predicate needs meaningful numbers, constraints on fields that some value meets, and clauses of its kind."""
    yield from _clauses(predicate, path)
    yield from number_problems(predicate.within, "a bound", (*path, "within_seconds"))
    yield from number_problems(predicate.rate, "a rate in Hz", (*path, "rate"))
    for name in ("deadline", "lease", "lifespan"):
        yield from number_problems(getattr(predicate.qos, name), f"a {name}", (*path, "qos", f"{name}_seconds"))
    yield from number_problems(predicate.qos.depth, "a depth", (*path, "qos", "depth"), most=MAX_DEPTH)
    for field, values in predicate.fields:
        where = (*path, "where", field)
        stated = values.values if isinstance(values, OneOf) else (values.low, values.high)
        numbers = [number for number in stated if isinstance(number, (int, float)) and not math.isinf(number)]
        if any(math.isnan(number) for number in numbers):
            yield Problem("E004", where, f"field {field}: not a number")
        elif any(abs(number) > MAX_NUMBER for number in numbers):
            most = format_number(MAX_NUMBER)
            help = f"write at most {most}, or leave out a bound that every value meets"
            yield Problem("E004", where, f"field {field}: a number is beyond {most}", help)
        elif values.is_empty:
            yield Problem("E016", where, f"no value of field {field} meets all its constraints ({values})")


def _clauses(predicate: Predicate, path: SubjectPath) -> Iterator[Problem]:
    """Messages have a rate, QoS and fields; services and ROS actions have a bound."""
    what = f"{predicate.type} is the type of {indefinite(KIND_WORDS[predicate.kind].connector)}"
    if predicate.kind == "topic":
        if predicate.within is not None and predicate.type:
            help = "state a rate (`@ 10 Hz`), or leave out the bound"
            yield Problem("E017", (*path, "within_seconds"), f"{what}, which answers no request within a bound", help)
        return
    stated = {"rate": predicate.rate is not None, "qos": predicate.qos != DEFAULT_QOS, "where": bool(predicate.fields)}
    for key, name in (("rate", "rate"), ("qos", "QoS"), ("where", "constraint on a field")):
        if stated[key]:
            help = f"state a bound (`{BOUND_WORDS[predicate.kind]} within 0.1 s`), or leave it out"
            yield Problem("E017", (*path, key), f"{what}, which has no {name}", help)


def component_rules(component: ComponentSpec, path: SubjectPath) -> Iterator[Problem]:
    """Ownership of outputs, M1, M2, M3, and the predicates and numbers of one component."""
    for name in component.input_order:
        yield from predicate_problems(component.inputs[name], (*path, "inputs", name))
        yield from _tolerance(component, name, (*path, "inputs", name, "tolerates"))
    for resource, amount in component.resource_usage.items():
        yield from number_problems(amount, f"the amount held of {resource}", (*path, "holds", resource))
    yield from number_problems(component.startup_seconds, "a start-up time", (*path, "takes_seconds"), zero=True)
    yield from number_problems(component.activate_seconds, "a time to activate", (*path, "activate_seconds"))
    if (stop := component.stop) is not None:
        yield from _ends(stop, path)
        for name, seconds, what in (
            ("drain", stop.drain, "a time to answer"),
            ("patience", stop.patience, "a time to end goals"),
        ):
            yield from number_problems(seconds, what, (*path, "stop_seconds", name), zero=True)
    for name, parameter in component.parameters.items():
        yield from value_problems(parameter.value, (*path, "parameters", name))
    for functionality in component:
        for mode in functionality.modes:
            for name, value in mode.parameters.items():
                where = (*path, "functionalities", functionality.name, "modes", mode.name, "parameters", name)
                yield from value_problems(value, where)
    yield from _ownership(component, path)
    for functionality in component:
        yield from _functionality_rules(functionality, (*path, "functionalities", functionality.name))


def _tolerance(component: ComponentSpec, name: str, path: SubjectPath) -> Iterator[Problem]:
    missed, assumption = component.tolerates.get(name), component.inputs[name]
    yield from number_problems(missed, f"the number of missed messages that {name} tolerates", path, most=MAX_DEPTH)
    kind, has_rate = assumption.kind, assumption.rate is not None or assumption.qos.deadline is not None
    if missed is not None and kind != "topic" and assumption.within is None:
        port = f"{KIND_WORDS[kind].input} {name}"
        message = f"{port} tolerates {missed} missed requests, but assumes no bound, so none is ever missed"
        help = f"state the bound that it assumes (`{BOUND_WORDS[kind]} within 0.1 s`), or leave out `tolerates`"
        yield Problem("E004", path, message, help)
    elif missed is not None and kind == "topic" and assumption.type and not has_rate:
        message = f"input {name} tolerates {missed} missed messages, but assumes no rate, so none is ever missed"
        yield Problem("E004", path, message, "state the rate that it assumes (`@ 10 Hz`), or leave out `tolerates`")
    if name in component.conditions and assumption.type and not assumption.fields:
        message = f"input {name} is a condition, but constrains no field, so every message meets it"
        yield Problem("E004", (*path[:-1], "condition"), message, "add `where …`, or leave out `condition`")


def _ownership(component: ComponentSpec, path: SubjectPath) -> Iterator[Problem]:
    misspelt = any(name not in component.outputs for f in component for name in f.outputs)
    guaranteed = {name for f in component for mode in f.modes for name in mode.guarantees}
    for index, output in enumerate(component.outputs):
        if output in component.outputs[:index]:
            continue
        owners = [functionality.name for functionality in component if output in functionality.outputs]
        where = (*path, "outputs", str(index))
        if len(owners) > 1:
            message = (
                f"{component.port_in_words(output)} is owned by {len(owners)} functionalities: {', '.join(owners)}"
            )
            yield Problem("E014", where, message, "let only one of them produce it")
        elif not owners and not misspelt and output not in guaranteed:  # else the mode that guarantees it is reported
            help = "add it to what a functionality `produces`"
            yield Problem("E013", where, f"no functionality produces output {output}", help)


def _functionality_rules(functionality: FunctionalitySpec, path: SubjectPath) -> Iterator[Problem]:
    name, modes = functionality.name, functionality.modes
    yield from number_problems(functionality.weight, f"the weight of {name}", (*path, "weight"), zero=True)
    if len(modes) < 2:
        count = "only one mode" if modes else "no mode"
        message = f"{name} has {count}, so there is nothing to degrade to"
        yield Problem("E015", (*path, "modes"), message, "add a last mode that assumes nothing")
    elif modes[-1].assumptions:
        assumed = ", ".join(str(assumption) for assumption in modes[-1].assumptions)
        message = f"M1: mode {modes[-1].name}, the last of {name}, must assume nothing, but assumes {assumed}"
        free = next((mode.name for mode in reversed(modes) if not mode.assumptions), None)
        help = "remove the assumption, or add a last mode without it"
        if free is not None:
            help = f"modes are listed best first: put {free}, which assumes nothing, last; or remove the assumption"
        yield Problem("E010", (*path, "modes", modes[-1].name), message, help)
    for mode in modes:
        where = (*path, "modes", mode.name)
        for index, assumption in enumerate(mode.assumptions):
            if not isinstance(assumption, InputAlternatives):
                yield from predicate_problems(assumption, (*where, "assumes", str(index)))
            elif not assumption.inputs:
                message = f"an assumption of mode {mode.name} of {name} names no input"
                yield Problem("E001", (*where, "assumes", str(index)), message, "name at least one")
        for output, guarantee in sorted(mode.guarantees.items()):
            yield from predicate_problems(guarantee, (*where, "guarantees", output))
    for output in dict.fromkeys(functionality.outputs):
        split = yield from _one_endpoint(functionality, output, path)
        for better, worse in pairwise(modes):
            yield from _monotone(functionality, output, better, worse, split, path)


def _one_endpoint(functionality: FunctionalitySpec, output: str, path: SubjectPath) -> Generator[Problem, None, bool]:
    """M3, reported for the first mode that disagrees. Returns whether there is one."""
    stated = [(mode, mode.guarantees[output]) for mode in functionality.modes if output in mode.guarantees]
    for mode, guarantee in stated[1:]:
        first_mode, first = stated[0]
        if guarantee.type != first.type:
            differ = f"type {first.type}", guarantee.type
            help = f"write {first.type} in both, or use two {KIND_WORDS[first.kind].output}s"
        elif not guarantee.qos.same_endpoint(first.qos):
            differ = _in_words(first.qos), _in_words(guarantee.qos)
            help = "state one QoS in both, or use two outputs"
        else:
            continue
        message = (
            f"M3: {KIND_WORDS[first.kind].output} {output} is one endpoint, but has {differ[0]} in mode"
            f" {first_mode.name} and {differ[1]} in mode {mode.name}"
        )
        yield Problem("E012", (*path, "modes", mode.name, "guarantees", output), message, help)
        return True
    return False


def _in_words(qos: QoS) -> str:
    return str(qos) or "the default QoS"


def _monotone(
    functionality: FunctionalitySpec, output: str, better: Mode, worse: Mode, split: bool, path: SubjectPath
) -> Iterator[Problem]:
    """M2 for two neighbours of the chain; for all pairs it follows, since ⊨ is transitive.

    For every q, worse ⊨ q must imply better ⊨ q. That holds iff worse is nothing or better ⊨ worse (take worse itself
    for q). Where the modes are ``split`` over type or QoS, that is reported as M3 alone.
    """
    least, most = worse.guarantee(output), better.guarantee(output)
    if not isinstance(least, Predicate):
        return
    if split and isinstance(most, Predicate):
        most = replace(most, type=least.type, qos=least.qos)
    if clauses := explain(most, least):
        message = (
            f"M2: mode {worse.name} of {functionality.name} guarantees {output} : {least},"
            f" which the better mode {better.name} does not ({', '.join(clauses)})"
        )
        help = f"guarantee at least that in {better.name}, or no more than {better.name} does in {worse.name}"
        yield Problem("E011", (*path, "modes", better.name, "guarantees", output), message, help)
