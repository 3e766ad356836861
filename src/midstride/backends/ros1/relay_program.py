"""The process of a relay on ROS 1 (:mod:`midstride.foreign.relay`); its argument is the file of its order."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import genpy

from midstride.backends.common_messages import message_class
from midstride.backends.ros1 import launching, names
from midstride.backends.ros1.host import Ros1Host
from midstride.backends.ros1.master import Master, SystemState
from midstride.foreign.graph_check import GraphEndpoint
from midstride.foreign.relay import RelayPlatform, run_relay
from midstride.foreign.relayed_program import RelayOrder
from midstride.model.contract import QoS
from midstride.node.component_host import Host
from midstride.node.process_context import ProcessContext

# What an endpoint of any type is registered with.
_ANY = "*"
# ROS 1 has no QoS to compare: these are offered by no less, and requested by no more, than any other.
_OFFERED, _REQUESTED = QoS(durability="transient_local"), QoS(reliability="best_effort")


def serialized(type_name: str) -> type:
    """The class of messages of that type that are not deserialised."""
    type_: Any = message_class(type_name)

    def initialize(message: Any, data: bytes = b"") -> None:
        message.data = data

    def deserialize(message: Any, data: bytes) -> Any:
        message.data = data
        return message

    fields = {
        "__slots__": ("data",),
        "__init__": initialize,
        "serialize": lambda message, buffer: buffer.write(message.data),
        "deserialize": deserialize,
        "_type": type_._type,
        "_md5sum": type_._md5sum,
        "_full_text": type_._full_text,
        "_has_header": False,  # so that the header stays as it is
    }
    return type(f"Serialized{type_.__name__}", (genpy.Message,), fields)


def decoder(type_name: str) -> Callable[[Any], Any]:
    """Reads what :func:`serialized` has left as it was."""
    type_: Any = message_class(type_name)
    return lambda message: type_().deserialize(message.data)


def join(context: ProcessContext) -> Host:
    host: Any = Ros1Host(context.instance or "", context.namespace, context.node or "")
    return host  # type: ignore[no-any-return]


def endpoints(host: Host, order: RelayOrder) -> Sequence[GraphEndpoint] | None:
    """The endpoints of the program, as the master lists them; None if it does not know the program's node.

    An endpoint that takes any type has the declared type. Raises BackendError where the master does not answer in time.
    """
    master = Master(launching.master_uri(os.environ), host.node_name or "")
    with ThreadPoolExecutor(1) as beside:  # this thread may have an event loop
        state, types = beside.submit(lambda: asyncio.run(_registered(master))).result()
    if order.node not in state.nodes():
        return None
    component = order.declaration.declared()
    declared = {topic: port for port, topic in order.topics.items()}
    found = []
    for output, listed, qos in ((True, state.publishers, _OFFERED), (False, state.subscribers, _REQUESTED)):
        for topic in (name for name, nodes in listed.items() if order.node in nodes and name not in names.INTERNAL):
            kind = types.get(topic, _ANY)
            if kind == _ANY and topic in declared:
                kind = component.type_of(declared[topic]) or _ANY
            found.append(GraphEndpoint(output, topic, kind, qos))
    return found


async def _registered(master: Master) -> tuple[SystemState, dict[str, str]]:
    """The registrations at the master, and the type of each topic. Raises BackendError."""
    return await master.state(), dict(await master.call("getTopicTypes", master.caller))


if __name__ == "__main__":
    run_relay(RelayPlatform(join, serialized, decoder, endpoints, advertises_late=True))
