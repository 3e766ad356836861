"""The configuration as the components report it, in contrast to the manager's model."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass

from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration
from midstride.runtime.component_client import ComponentClient
from midstride.wire.state import ComponentState


@dataclass(frozen=True, slots=True)
class ObservedConfiguration:
    """The configuration as reported; instances in ``silent`` have reported nothing lately and are as in the model."""

    configuration: Configuration
    silent: tuple[str, ...]


def observe(
    configuration: Configuration, client: ComponentClient, exited: Container[str] = ()
) -> ObservedConfiguration:
    """``configuration`` with the modes and attachments that its components report, without those in ``exited``."""
    for name in [name for name in configuration.instances if name in exited]:
        configuration = configuration.without_instance(name)
    silent = []
    for name in sorted(configuration.instances):
        state = client.responsive(name)
        if state is None:
            silent.append(name)
        else:
            configuration = _as_reported(configuration, name, state)
    return ObservedConfiguration(configuration, tuple(silent))


def own_degradations(
    configuration: Configuration, client: ComponentClient, exited: Container[str]
) -> dict[FunctionalityRef, int]:
    """The functionalities that report a worse mode than the model has, except those of ``exited``."""
    degraded: dict[FunctionalityRef, int] = {}
    for name in sorted(configuration.instances):
        latest = client.latest(name)
        if latest is not None and name not in exited:
            degraded.update(own_degradations_in(configuration, latest.state))
    return degraded


def own_degradations_in(configuration: Configuration, state: ComponentState) -> dict[FunctionalityRef, int]:
    """The functionalities of one component that report a worse mode than the model has."""
    if state.instance not in configuration.instances:
        return {}
    degraded: dict[FunctionalityRef, int] = {}
    for functionality, view in state.functionalities.items():
        ref = FunctionalityRef(state.instance, functionality)
        index = configuration.functionality(ref).mode_index(view.mode)
        if index > configuration.modes[ref]:
            degraded[ref] = index
    return degraded


def _as_reported(configuration: Configuration, name: str, state: ComponentState) -> Configuration:
    modes = {}
    for functionality, view in state.functionalities.items():
        ref = FunctionalityRef(name, functionality)
        modes[ref] = configuration.functionality(ref).mode_index(view.mode)
    configuration = configuration.with_modes(modes)
    # Components know topics, not connectors. An output behind a closed gate is not attached.
    reported = {
        (PortRef(name, port), topic)
        for port, topics in state.ports.items()
        for topic, link in topics.items()
        if link.gate != "closed"
    }
    known = set()
    for port, connector in configuration.attached_ports(name):
        pair = (port, configuration.context.connectors[connector].topic)
        known.add(pair)
        if pair not in reported:
            configuration = configuration.without_attachment(port, connector)
    if unknown := sorted(reported - known):
        by_topic = {connector.topic: key for key, connector in configuration.context.connectors.items()}
        for port, topic in unknown:
            configuration = configuration.with_attachment(port, by_topic.get(topic, topic))
    return configuration
