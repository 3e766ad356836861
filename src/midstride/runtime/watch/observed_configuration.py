"""The configuration as the components report it, in contrast to the manager's model."""

from __future__ import annotations

from collections.abc import Iterable

from midstride.model.best import lowered
from midstride.model.component import ComponentSpec, FunctionalityRef, PortRef
from midstride.model.configuration import Configuration
from midstride.runtime.instance_life import LifeTable
from midstride.wire.state import ComponentState


def observe(configuration: Configuration, life: LifeTable) -> tuple[Configuration, list[str]]:
    """``configuration`` with the modes and attachments that its components report, without those that have exited.

    The second value names the silent ones, which have reported nothing lately: they are as in ``configuration``.
    """
    silent = []
    for name in sorted(configuration.instances):
        if life.has_exited(name):
            configuration = configuration.without_instance(name)
        elif life.is_done(name):
            continue
        elif (state := life.responsive(name)) is None:
            silent.append(name)
        else:
            configuration = configuration.with_modes(reported_modes(configuration.component(name), state))
            configuration = with_attachments(configuration, *changed_attachments(configuration, state))
    return configuration, silent


def own_degradations(configuration: Configuration, life: LifeTable) -> dict[FunctionalityRef, int]:
    """The functionalities that report a worse mode than the model has."""
    latest = [life.latest(name) for name in sorted(configuration.instances)]
    found = [own_degradations_in(configuration, each.state) for each in latest if each is not None]
    return {ref: index for degraded in found for ref, index in degraded.items()}


def own_degradations_in(configuration: Configuration, state: ComponentState) -> dict[FunctionalityRef, int]:
    """The functionalities of one component that report a worse mode than the model has."""
    if state.instance not in configuration.instances:
        return {}
    reported = reported_modes(configuration.component(state.instance), state)
    return {ref: index for ref, index in reported.items() if index > configuration.modes[ref]}


def with_failures(configuration: Configuration, instances: Iterable[str], life: LifeTable) -> Configuration:
    """``configuration`` with what ``instances`` have degraded by themselves, and without those that have exited."""
    for name in instances:
        if life.has_exited(name):
            configuration = configuration.without_instance(name)
        elif (latest := life.latest(name)) is not None:
            configuration = configuration.with_modes(own_degradations_in(configuration, latest.state))
    return configuration


def reported_modes(component: ComponentSpec, state: ComponentState) -> dict[FunctionalityRef, int]:
    """The mode of each functionality of one component, as it reports it."""
    return {
        FunctionalityRef(state.instance, name): component.functionalities[name].mode_index(view.mode)
        for name, view in state.functionalities.items()
    }


def changed_attachments(
    configuration: Configuration, state: ComponentState
) -> tuple[list[tuple[PortRef, str]], list[tuple[PortRef, str]]]:
    """The attachments that one component lacks by its own report, and those that it has besides.

    Components know topics, not connectors: where a topic has no connector here, it stands for one.
    """
    name = state.instance
    # An output behind a closed gate is not attached.
    reported = {
        (PortRef(name, port), topic)
        for port, topics in state.ports.items()
        for topic, link in topics.items()
        if link.gate != "closed"
    }
    modelled = [(port, key, configuration.topic(key)) for port, key in configuration.attached_ports(name)]
    lacking = [(port, key) for port, key, topic in modelled if (port, topic) not in reported]
    unknown = sorted(reported - {(port, topic) for port, _, topic in modelled})
    if not unknown:
        return lacking, []
    by_topic = {connector.topic: key for key, connector in configuration.context.connectors.items()}
    return lacking, [(port, by_topic.get(topic, topic)) for port, topic in unknown]


def left_closed(configuration: Configuration, state: ComponentState) -> list[tuple[PortRef, str]]:
    """The outputs, with their topics, that one component has behind a closed gate, and that the model does not have.

    Outside a change they are what is left of a hand-over. An inactive lifecycle node has closed gates too, and opens
    them only on command; a fenced output stays closed.
    """
    name = state.instance
    if name not in configuration.instances or configuration.component(name).has_lifecycle:
        return []
    modelled = {(port, configuration.topic(key)) for port, key in configuration.attached_ports(name)}
    return [
        (PortRef(name, port), topic)
        for port, topics in sorted(state.ports.items())
        for topic, link in sorted(topics.items())
        if link.gate == "closed" and not link.fenced and (PortRef(name, port), topic) not in modelled
    ]


def unsupported_modes(configuration: Configuration, state: ComponentState) -> dict[FunctionalityRef, int]:
    """The functionalities of one component that report a better mode than the model has, and lack its support.

    A command that timed out, and was undone in the model, may be carried out later. No report is older than the
    model: a component reports a change before it replies, on the same connection.
    """
    if state.instance not in configuration.instances:
        return {}
    reported = reported_modes(configuration.component(state.instance), state)
    better = {ref: index for ref, index in reported.items() if index < configuration.modes[ref]}
    if not better:
        return {}
    unsupported = lowered(configuration.with_modes(better), better)
    return {ref: index for ref, index in better.items() if ref in unsupported}


def differs(configuration: Configuration, state: ComponentState) -> bool:
    """Return whether a component of the model has other attachments there than it reports."""
    return state.instance in configuration.instances and any(changed_attachments(configuration, state))


def with_attachments(
    configuration: Configuration, lacking: Iterable[tuple[PortRef, str]], besides: Iterable[tuple[PortRef, str]]
) -> Configuration:
    """``configuration`` without the attachments ``lacking``, and with those in ``besides``."""
    for port, connector in lacking:
        configuration = configuration.without_attachment(port, connector)
    for port, connector in besides:
        configuration = configuration.with_attachment(port, connector)
    return configuration
