"""The configuration as the components report it, in contrast to the manager's model."""

from __future__ import annotations

from collections.abc import Container, Iterable

from midstride.model.component import ComponentSpec, FunctionalityRef, PortRef
from midstride.model.configuration import Configuration
from midstride.runtime.component_client import ComponentClient
from midstride.wire.state import ComponentState


def observe(
    configuration: Configuration, client: ComponentClient, exited: Container[str]
) -> tuple[Configuration, list[str]]:
    """``configuration`` with the modes and attachments that its components report, without those in ``exited``.

    The second value names the silent ones, which have reported nothing lately: they are as in ``configuration``.
    """
    silent = []
    for name in sorted(configuration.instances):
        if name in exited:
            configuration = configuration.without_instance(name)
        elif (state := client.responsive(name)) is None:
            silent.append(name)
        else:
            configuration = _as_reported(configuration, name, state)
    return configuration, silent


def own_degradations(
    configuration: Configuration, client: ComponentClient, exited: Container[str]
) -> dict[FunctionalityRef, int]:
    """The functionalities that report a worse mode than the model has, except those of ``exited``."""
    latest = [client.latest(name) for name in sorted(configuration.instances) if name not in exited]
    found = [own_degradations_in(configuration, each.state) for each in latest if each is not None]
    return {ref: index for degraded in found for ref, index in degraded.items()}


def own_degradations_in(configuration: Configuration, state: ComponentState) -> dict[FunctionalityRef, int]:
    """The functionalities of one component that report a worse mode than the model has."""
    if state.instance not in configuration.instances:
        return {}
    reported = reported_modes(configuration.component(state.instance), state)
    return {ref: index for ref, index in reported.items() if index > configuration.modes[ref]}


def with_failures(
    configuration: Configuration, instances: Iterable[str], client: ComponentClient, exited: Container[str]
) -> Configuration:
    """``configuration`` with what ``instances`` have degraded by themselves, and without those in ``exited``."""
    for name in instances:
        if name in exited:
            configuration = configuration.without_instance(name)
        elif (latest := client.latest(name)) is not None:
            configuration = configuration.with_modes(own_degradations_in(configuration, latest.state))
    return configuration


def reported_modes(component: ComponentSpec, state: ComponentState) -> dict[FunctionalityRef, int]:
    """The mode of each functionality of one component, as it reports it."""
    return {
        FunctionalityRef(state.instance, name): component.functionalities[name].mode_index(view.mode)
        for name, view in state.functionalities.items()
    }


def _as_reported(configuration: Configuration, name: str, state: ComponentState) -> Configuration:
    configuration = configuration.with_modes(reported_modes(configuration.component(name), state))
    # Components know topics, not connectors. An output behind a closed gate is not attached.
    reported = {
        (PortRef(name, port), topic)
        for port, topics in state.ports.items()
        for topic, link in topics.items()
        if link.gate != "closed"
    }
    known = set()
    for port, connector in configuration.attached_ports(name):
        pair = (port, configuration.topic(connector))
        known.add(pair)
        if pair not in reported:
            configuration = configuration.without_attachment(port, connector)
    if unknown := sorted(reported - known):
        by_topic = {connector.topic: key for key, connector in configuration.context.connectors.items()}
        for port, topic in unknown:
            configuration = configuration.with_attachment(port, by_topic.get(topic, topic))
    return configuration
