"""The configuration as the components themselves tell it, beside the one that the manager believes in."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass
from typing import Any, Final

from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration
from midstride.runtime.clock import Clock
from midstride.runtime.component_client import ComponentClient
from midstride.runtime.status import observed

# How long a component's own word is waited for (s).
TIMEOUT: Final = 1.0


@dataclass(frozen=True, slots=True)
class ObservedConfiguration:
    """What the components tell. Of those in ``silent``, which did not answer in time, the model's word is taken."""

    configuration: Configuration
    silent: tuple[str, ...]


async def live(
    configuration: Configuration, link: ComponentClient, clock: Clock, gone: Container[str] = ()
) -> ObservedConfiguration:
    """The modes and attachments that the components report; without those in ``gone``, which have ended."""
    for name in [name for name in configuration.instances if name in gone]:
        configuration = configuration.without_instance(name)
    states = await observed(sorted(configuration.instances), link, clock, TIMEOUT)
    for name, state in states.items():
        if state is not None:
            configuration = _as_told(configuration, name, state)
    return ObservedConfiguration(configuration, tuple(name for name, state in states.items() if state is None))


def _as_told(configuration: Configuration, name: str, state: dict[str, Any]) -> Configuration:
    modes = {}
    for functionality, view in state["functionalities"].items():
        ref = FunctionalityRef(name, functionality)
        modes[ref] = configuration.functionality(ref).mode_index(view["mode"])
    configuration = configuration.with_modes(modes)
    # A component knows topics alone; what stands behind a closed gate is not attached yet, or no longer.
    told = {
        (PortRef(name, port), topic)
        for port, topics in state["ports"].items()
        for topic, view in topics.items()
        if view["gate"] != "closed"
    }
    known = set()
    for port, connector in configuration.attached_ports(name):
        pair = (port, configuration.context.connectors[connector].topic)
        known.add(pair)
        if pair not in told:
            configuration = configuration.without_attachment(port, connector)
    if unknown := sorted(told - known):
        by_topic = {connector.topic: key for key, connector in configuration.context.connectors.items()}
        for port, topic in unknown:
            configuration = configuration.with_attachment(port, by_topic.get(topic, topic))
    return configuration
