"""The instance of a role that answers the requests to its node, as instances come and leave."""

from __future__ import annotations

from collections.abc import Mapping

from midstride.errors import MidstrideError
from midstride.model.component import PortRef
from midstride.model.configuration import Configuration
from midstride.runtime.process.answering_instance import have_answer
from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.records.events import EventLog


def serves(configuration: Configuration, port: PortRef, connector: str) -> bool:
    """Return whether ``port`` is a server, of a service or a ROS action."""
    return configuration.is_output(port) and not configuration.is_topic(connector)


async def have_first_answer(
    client: ComponentClient, events: EventLog, configuration: Configuration, instance: str, moving: Mapping[str, str]
) -> None:
    """Have a new server answer where no other instance of its role serves: nothing is handed over to it then.

    Where the state of that instance moves to it, as ``moving`` says, it answers from then on: all requests to the node
    are answered by one of the two, and what they change would be lost. So it is also where that is removed first.
    """
    role = configuration.instances[instance].role
    for other in configuration.instances_of(role):
        attached = [port for port, key in configuration.attached_ports(other.name) if serves(configuration, port, key)]
        if other.name == instance or attached or moving.get(other.name) == instance:
            continue
        old = None if client.life.is_gone(other.name) else other.name
        try:
            left = await have_answer(client, instance, old, other.component.stop_times.drain)
            if left is not None:
                events.add("note", left)
        except MidstrideError as error:
            events.add("note", f"{instance} does not answer requests to {role} yet: {error}")


async def have_others_answer(
    client: ComponentClient, events: EventLog, configuration: Configuration, leaving: str, runs: bool
) -> dict[str, str]:
    """Have another instance of its role, if there is one, answer from now on; ``runs``: whether that does.

    Returns those that do not, and why.
    """
    role = configuration.instances[leaving].role
    drain = configuration.component(leaving).stop_times.drain
    failed: dict[str, str] = {}
    for other in configuration.instances_of(role):
        if other.name != leaving and not client.life.is_gone(other.name):
            try:
                left = await have_answer(client, other.name, leaving if runs else None, drain)
                if left is not None:
                    events.add("note", left)
            except MidstrideError as error:
                failed[other.name] = f"{other.name} does not answer requests to {role}: {error}"
                events.add("note", failed[other.name])
    return failed
