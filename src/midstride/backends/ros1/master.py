"""ROS 1's master: what is registered there, and putting right what a killed node has left.

The master believes what it was told until it is told otherwise: a killed node stays registered for ever,
and whoever is later given its port is taken for it (platform.md). So its registrations are taken back
the moment its end is known.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import Any, Final

from midstride.backends.ros1 import rpc
from midstride.errors import BackendError, CallTimeout, Unreachable
from midstride.runtime.timeouts import within

# How long a node that may be dead is given to say that it is not (s).
PROBE: Final = 0.5
# A registration under way when its node was killed may arrive after it has been looked for.
_ROUNDS: Final = 3
# The parameter to which rospy subscribes with a node's first log message, and never unsubscribes.
_PARAMETER: Final = "/rosout_disable_topics_generation"


@dataclass(frozen=True, slots=True)
class SystemState:
    """Who publishes, subscribes and serves: the nodes of each topic and service."""

    publishers: dict[str, tuple[str, ...]]
    subscribers: dict[str, tuple[str, ...]]
    services: dict[str, tuple[str, ...]]

    def nodes(self) -> frozenset[str]:
        kinds = (self.publishers, self.subscribers, self.services)
        return frozenset(node for kind in kinds for nodes in kind.values() for node in nodes)


class Master:
    """Asks the master at ``uri``, as the node ``caller``. Every method raises BackendError kinds only."""

    def __init__(self, uri: str, caller: str) -> None:
        self.uri = uri
        self.caller = caller

    async def ask(self, method: str, *arguments: Any, timeout: float = rpc.PATIENCE) -> Any:
        """The value that a method of the master returns. Raises BackendError with the master's own words."""
        answer = await rpc.call(self.uri, method, *arguments, timeout=timeout)
        if not isinstance(answer, list) or len(answer) != 3:
            raise Unreachable(f"{self.uri} is no ROS 1 master: it answers {answer!r}")
        code, words, value = answer
        if code != 1:
            raise BackendError(f"the ROS master refuses {method}: {words}")
        return value

    async def process(self, timeout: float = PROBE) -> int | None:
        """The number of the master's process; None where no master answers there."""
        try:
            return int(await self.ask("getPid", self.caller, timeout=timeout))
        except (Unreachable, CallTimeout):
            return None

    async def state(self) -> SystemState:
        publishers, subscribers, services = await self.ask("getSystemState", self.caller)
        kinds = [{name: tuple(nodes) for name, nodes in kind} for kind in (publishers, subscribers, services)]
        return SystemState(*kinds)

    async def address_of(self, node: str) -> str | None:
        """Where a node said it can be called; None where the master knows of none."""
        try:
            return str(await self.ask("lookupNode", self.caller, node))
        except (Unreachable, CallTimeout):
            raise
        except BackendError:
            return None

    async def service_at(self, service: str) -> str:
        """Where a service can be called. Raises Unreachable where there is none."""
        try:
            return str(await self.ask("lookupService", self.caller, service))
        except (Unreachable, CallTimeout):
            raise
        except BackendError:
            raise Unreachable(f"no node serves {service}") from None

    async def forget(self, node: str) -> None:
        """Take back every registration of a node that has ended. Raises BackendError where that cannot be done."""
        for _ in range(_ROUNDS):
            where = await self.address_of(node)
            if where is None:
                return
            state = await self.state()
            for method, kind in (("Publisher", state.publishers), ("Subscriber", state.subscribers)):
                for topic, nodes in kind.items():
                    if node in nodes:
                        await self.ask(f"unregister{method}", node, topic, where)
            for service, nodes in state.services.items():
                if node in nodes:
                    await self.ask("unregisterService", node, service, await self.service_at(service))
            await self.ask("unsubscribeParam", node, where, _PARAMETER)
            if await self.address_of(node) is None:
                return
            await self._forget_parameters(node, where)
        raise BackendError(f"the ROS master does not let go of {node}, which has ended")

    async def _forget_parameters(self, node: str, where: str) -> None:
        """What is left is subscriptions to parameters that nobody can list.

        They go when the node is registered anew from elsewhere. The master then tells whoever is at the old
        address to shut down: so nobody may be there.
        """
        host, port, _ = rpc.address(where)
        try:
            async with within(PROBE):
                _, writer = await asyncio.open_connection(host, port)
        except ConnectionRefusedError:
            service, nowhere = f"{node}/gone", "http://127.0.0.1:1/"
            await self.ask("registerService", node, service, "rosrpc://127.0.0.1:1", nowhere)
            await self.ask("unregisterService", node, service, "rosrpc://127.0.0.1:1")
        except (OSError, asyncio.TimeoutError):
            pass
        else:
            writer.close()

    async def holder(self, node: str) -> bool:
        """Whether a node of that name is there and alive; what a dead one has left is taken back.

        At its address somebody else may answer by now. ROS's Python nodes tell their names; one that does
        not is taken at the master's word.
        """
        where = await self.address_of(node)
        if where is None:
            return False
        try:
            answer = await rpc.call(where, "getName", self.caller, timeout=PROBE)
        except CallTimeout:
            return True  # it may be frozen: that is not dead
        except Unreachable:
            await self.forget(node)
            return False
        except BackendError:
            return True
        if isinstance(answer, list) and answer[:1] == [1] and answer[-1] != node:
            await self.forget(node)
            return False
        return True
