"""Hypothesis strategies over actions: what may be tried on a configuration, possible or not."""

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
from midstride.testing.strategies import GeneratedSystem

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
    """Actions that speak of what there is, and now and then of what there is not. Many, not all, may be taken."""
    configuration = scene.configuration
    kind = draw(st.sampled_from(kinds))
    names = [*sorted(configuration.instances), "nobody"]
    if kind == "create":
        name = draw(st.sampled_from(("fresh", names[0])))
        return Create(Instance(name, name, draw(st.sampled_from(scene.components))))
    if kind == "remove":
        isolated = [name for name in names[:-1] if not configuration.attached_ports(name)]
        return Remove(draw(st.sampled_from(isolated * 3 + names)))
    if kind == "set":
        return SetParameters(draw(st.sampled_from(names)), Map([draw(st.sampled_from(_SETTINGS))]))
    if kind == "degrade":
        return Degrade(Map(_moved(draw, configuration, better=False)))
    if kind == "upgrade":
        return Upgrade(Map(_moved(draw, configuration, better=True)))
    attached = sorted(configuration.attachments())
    ports = [PortRef(name, port) for name in names[:-1] for port in configuration.component(name).ports()]
    topics = sorted(configuration.context.connectors)
    if kind == "attach":
        free = [(port, topic) for port in ports for topic in topics if not configuration.is_attached(port, topic)]
        fit = [
            pair
            for pair in free
            if not contract_reasons(configuration, pair[0], configuration.context.connectors[pair[1]])
        ]
        strange = [
            (PortRef("nobody", "out0"), topics[0]),
            (PortRef(names[0], "in0"), "/none"),
            (PortRef(names[0], "x"), topics[0]),
        ]
        return Attach(*draw(st.sampled_from(fit * 3 + free + attached[:1] + strange)))
    if kind == "detach":
        return Detach(
            *draw(
                st.sampled_from(
                    attached * 2 + [(port, topics[0]) for port in ports] + [(PortRef("nobody", "x"), "/t0")]
                )
            )
        )
    return Handover(_swaps(draw, configuration, ports, attached))


def _moved(draw: st.DrawFn, configuration: Configuration, *, better: bool) -> dict[FunctionalityRef, int]:
    """New modes for one functionality or a group; now and then one that is not better (worse) at all."""
    refs = sorted(configuration.modes)
    movable = [
        ref
        for ref in refs
        if (
            configuration.modes[ref] > 0
            if better
            else configuration.modes[ref] < configuration.functionality(ref).last_mode
        )
    ]
    if not refs:
        return {}
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
