"""A component's state as ROS diagnostics, for the tools that show ``/diagnostics`` (REP 107).

One entry for the component itself, and one for each attachment, in the terms of ROS's own ``diagnostic_updater``: rqt,
the aggregator and a bag then show the contracts of every node, declared against measured.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from midstride.model.component import ComponentSpec, InputAlternatives
from midstride.model.contract import format_number
from midstride.wire.state import ComponentState, LinkState, Measured


class Level(enum.IntEnum):
    """The levels of ``diagnostic_msgs/DiagnosticStatus``."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True, slots=True)
class DiagnosticEntry:
    """An entry of ``diagnostic_msgs/DiagnosticArray``: its name without the node's, and its values by key."""

    name: str
    level: Level
    message: str
    values: dict[str, str]


def diagnostics(state: ComponentState, component: ComponentSpec) -> list[DiagnosticEntry]:
    """The diagnostics of a component. STALE while it waits for its clock: then nothing can be measured."""
    modes = {name: each.mode for name, each in state.functionalities.items()}
    relied_on = _relied_on(component, modes)
    entries = [_component(state, component)]
    for port, topics in state.ports.items():
        declared = component.stated_rate(port, modes)
        entries += [_attachment(port, topic, link, declared, port in relied_on) for topic, link in topics.items()]
    if state.waiting is None or not state.simulated_time or state.clock_speed:
        return entries
    return [DiagnosticEntry(each.name, Level.STALE, state.waiting, each.values) for each in entries]


def _relied_on(component: ComponentSpec, modes: Mapping[str, str]) -> set[str]:
    """The inputs that a current mode assumes, without an alternative."""
    current = [mode for each in component for mode in each.modes if mode.name == modes[each.name]]
    assumed = [assumption for mode in current for assumption in mode.assumptions]
    return {each.inputs[0] for each in assumed if isinstance(each, InputAlternatives) and len(each.inputs) == 1}


def _component(state: ComponentState, component: ComponentSpec) -> DiagnosticEntry:
    lowered = [
        f"{name} is in mode {each.mode}: {_first_line(each.because)}"
        for name, each in state.functionalities.items()
        if each.mode != component.functionalities[name].modes[0].name
    ]
    values = {f"mode of {name}": each.mode for name, each in state.functionalities.items()}
    level, message = Level.OK, "every functionality is in its normal mode"
    if worse := [*([] if state.waiting is None else [state.waiting]), *lowered]:
        level, message = Level.WARN, "; ".join(worse)
    return DiagnosticEntry("component", level, message, values)


def _first_line(text: str) -> str:
    return text.strip().partition("\n")[0]


def _attachment(port: str, topic: str, link: LinkState, declared: float | None, relied_on: bool) -> DiagnosticEntry:
    level, message = Level.OK, "as declared" if declared or link.fields else "no rate and no fields are declared"
    if link.gate == "closed":
        message = "the gate is closed: nothing is published"
    else:
        # What nothing relies on is worth a warning only.
        silence = Level.ERROR if relied_on or link.gate is not None else Level.WARN
        level, message = max(_faults(link, declared, silence), default=(level, message))
    return DiagnosticEntry(f"{port} on {topic}", level, message, _values(link, declared))


def _faults(link: LinkState, declared: float | None, silence: Level) -> Iterator[tuple[Level, str]]:
    measured = link.measured
    if measured is not None and declared is not None and measured.meets(declared) is False:
        if measured.rate:
            yield Level.WARN, f"{measured.rate:.3g} Hz measured, {format_number(declared)} Hz declared"
        else:
            seconds = measured.covered if measured.age is None else measured.age
            yield silence, f"no message for {seconds:.1f} s, {format_number(declared)} Hz declared"
    for path, samples in link.fields.items():
        if samples.run:
            yield Level.WARN, f"{path} is {samples.last}, declared {path} {samples.constraint}"


def _values(link: LinkState, declared: float | None) -> dict[str, str]:
    """In the words of ROS's FrequencyStatus where it has them."""
    measured = link.measured or Measured(window=0.0)
    numbers = {
        "Declared frequency (Hz)": declared,
        "Actual frequency (Hz)": measured.rate,
        "Duration of window (s)": measured.window,
        "Age of the last message (s)": measured.age,
        "Jitter (s)": measured.jitter,
        "Longest time between messages (s)": measured.longest,
    }
    values = {key: "unknown" if value is None else f"{value:.6g}" for key, value in numbers.items()}
    if declared is None:
        values["Declared frequency (Hz)"] = "none"
    values["Events since attached"] = str(link.count)
    if link.gate is not None:
        values |= {"Gate": link.gate, "Events behind the closed gate": str(link.gated)}
    for path, samples in link.fields.items():
        values[f"Declared {path}"] = samples.constraint
        values[f"Violations of {path}"] = f"{samples.violations} of {samples.checked} checked"
        if samples.violations:
            values[f"Last violation of {path}"] = str(samples.last)
    return values
