"""Hypothesis strategies over actions on a configuration, allowed or not."""

from __future__ import annotations

from typing import Final

from hypothesis import strategies as st
from immutables import Map

from midstride.model.action import (
    Action,
    Attach,
    Create,
    Degrade,
    Detach,
    Handover,
    Remove,
    SetParameters,
    Swap,
    Upgrade,
    contract_reasons,
)
from midstride.model.component import FunctionalityRef, ParameterValue, PortRef
from midstride.model.configuration import Configuration, Instance
from midstride.model.contract import satisfies
from tests.strategies.systems import GeneratedSystem

_KINDS: Final = ("create", "remove", "attach", "detach", "degrade", "upgrade", "upgrade", "handover", "handover", "set")
_SETTINGS: Final[tuple[tuple[str, ParameterValue], ...]] = (
    ("gain", 0.9),
    ("gain", 2),
    ("gain", "much"),
    ("model", "large"),
    ("colour", 1),
)


@st.composite
def actions(draw: st.DrawFn, scene: GeneratedSystem, *, kinds: tuple[str, ...] = _KINDS) -> Action:
    """Actions that mostly refer to what exists, and sometimes to what does not. Many are allowed, not all."""
    configuration = scene.configuration
    live, context = sorted(configuration.instances), configuration.context
    names, topics, attached = [*live, "unknown"], sorted(context.connectors), sorted(configuration.attachments())
    ports = [PortRef(name, port) for name in live for port in configuration.component(name).ports()]
    match draw(st.sampled_from(kinds)):
        case "create":
            name = draw(st.sampled_from(("fresh", names[0])))
            return Create(Instance(name, name, draw(st.sampled_from(scene.components))))
        case "remove":
            isolated = [name for name in live if not configuration.attached_ports(name)]
            return Remove(draw(st.sampled_from(isolated * 3 + names)))
        case "set":
            before = draw(st.sampled_from((None, Map(gain=0.1))))
            return SetParameters(draw(st.sampled_from(names)), Map([draw(st.sampled_from(_SETTINGS))]), before)
        case "degrade":
            return Degrade(Map(_moved(draw, configuration, better=False)))
        case "upgrade":
            return Upgrade(Map(_moved(draw, configuration, better=True)))
        case "attach":
            free = [(port, topic) for port in ports for topic in topics if not configuration.is_attached(port, topic)]
            fit = [
                (port, topic)
                for port, topic in free
                if not contract_reasons(configuration, port, context.connectors[topic])
            ]
            ports_and_topics = ("unknown", "out0", topics[0]), (names[0], "in0", "/none"), (names[0], "x", topics[0])
            strange = [(PortRef(name, port), topic) for name, port, topic in ports_and_topics]
            return Attach(*draw(st.sampled_from(fit * 3 + free + attached[:1] + strange)))
        case "detach":
            unattached = [(port, topics[0]) for port in [*ports, PortRef("unknown", "x")]]
            return Detach(*draw(st.sampled_from(attached * 2 + unattached)))
        case _:
            return Handover(_swaps(draw, configuration, ports, attached))


def _moved(draw: st.DrawFn, configuration: Configuration, *, better: bool) -> dict[FunctionalityRef, int]:
    """New modes for one functionality or a group; sometimes one that is not better (worse)."""
    refs = sorted(configuration.modes)
    if not refs:
        return {}
    limits = {ref: 0 if better else configuration.functionality(ref).last_mode for ref in refs}
    movable = [ref for ref in refs if configuration.modes[ref] != limits[ref]]
    count = draw(st.sampled_from((1, 1, 1, 2, 3, 0)))
    chosen = [draw(st.sampled_from(movable * 4 + refs)) for _ in range(count)]
    modes = {}
    for ref in dict.fromkeys(chosen):
        last, now = configuration.functionality(ref).last_mode, configuration.modes[ref]
        proper = range(now) if better else range(now + 1, last + 1)
        modes[ref] = draw(st.sampled_from(proper or range(last + 2)))
    return modes


def _swaps(
    draw: st.DrawFn, configuration: Configuration, ports: list[PortRef], attached: list[tuple[PortRef, str]]
) -> tuple[Swap, ...]:
    outputs = [port for port in ports if configuration.is_output(port)]
    leaving = [pair for pair in attached if configuration.is_output(pair[0])]
    if not attached:
        return ()
    swaps = []
    for _ in range(draw(st.sampled_from((1, 1, 1, 2, 2, 0)))):
        old, connector = draw(st.sampled_from(leaving * 4 + attached))
        needed = configuration.context.connectors[connector].guarantee
        able = [port for port in outputs if satisfies(configuration.guarantee(port), needed)]
        free = [port for port in able if not configuration.is_attached(port, connector)]
        swaps.append(Swap(connector, old, draw(st.sampled_from(free * 6 + outputs * 2 + ports))))
    return tuple(swaps)
