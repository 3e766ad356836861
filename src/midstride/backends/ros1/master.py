"""ROS 1's master: what is registered there, and taking back what a killed node has left.

The master keeps a registration until it is withdrawn: a killed node stays registered for ever, and a process that is
later given its port is taken for it. So a component's registrations are withdrawn the moment its end is known.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import Any, Final

from midstride.backends.ros1 import rpc
from midstride.errors import BackendError, CallTimeout, Unreachable
from midstride.runtime.timeouts import within

# How long a node that may be dead has to answer (s).
PROBE: Final = 0.5
# A registration under way when its node was killed may arrive after the first look.
_ROUNDS: Final = 3
# The parameter to which rospy subscribes with a node's first log message, and never unsubscribes.
_PARAMETER: Final = "/rosout_disable_topics_generation"


@dataclass(frozen=True, slots=True)
class SystemState:
    """The nodes of each topic and service."""

    publishers: dict[str, tuple[str, ...]]
    subscribers: dict[str, tuple[str, ...]]
    services: dict[str, tuple[str, ...]]

    def nodes(self) -> frozenset[str]:
        kinds = (self.publishers, self.subscribers, self.services)
        return frozenset(node for kind in kinds for nodes in kind.values() for node in nodes)


class Master:
    """Calls the master at ``uri`` under the name ``caller``. Every method raises BackendError kinds only."""

    def __init__(self, uri: str, caller: str) -> None:
        self.uri = uri
        self.caller = caller

    async def call(self, method: str, *arguments: Any, timeout: float = rpc.PATIENCE) -> Any:
        """The value that a method of the master returns. Raises BackendError with the master's own words."""
        answer = await rpc.call(self.uri, method, *arguments, timeout=timeout)
        if not isinstance(answer, list) or len(answer) != 3:
            raise Unreachable(f"{self.uri} is not a ROS 1 master: it answers {answer!r}")
        code, words, value = answer
        if code != 1:
            raise BackendError(f"the ROS master refuses {method}: {words}")
        return value

    async def process(self, timeout: float = PROBE) -> int | None:
        """The pid of the master; None where no master answers."""
        try:
            return int(await self.call("getPid", self.caller, timeout=timeout))
        except (Unreachable, CallTimeout):
            return None

    async def state(self) -> SystemState:
        publishers, subscribers, services = await self.call("getSystemState", self.caller)
        kinds = [{name: tuple(nodes) for name, nodes in kind} for kind in (publishers, subscribers, services)]
        return SystemState(*kinds)

    async def address_of(self, node: str) -> str | None:
        """The address that a node has registered; None where the master knows no such node."""
        try:
            return str(await self.call("lookupNode", self.caller, node))
        except (Unreachable, CallTimeout):
            raise
        except BackendError:
            return None

    async def set_parameter(self, name: str, value: Any) -> None:
        """``name``: in full. Raises BackendError, also where XML-RPC has no such value."""
        try:
            await self.call("setParam", self.caller, name, value)
        except (OverflowError, TypeError) as error:
            raise BackendError(f"the ROS master cannot have {value!r} as the parameter {name}: {error}") from None

    async def delete_parameter(self, name: str) -> None:
        """``name``: in full. Raises BackendError where no master answers."""
        try:
            await self.call("deleteParam", self.caller, name)
        except (Unreachable, CallTimeout):
            raise
        except BackendError:
            pass  # it is not set any more

    async def unregister(self, node: str) -> None:
        """Withdraw every registration of a node that has ended. Raises BackendError where that cannot be done."""
        for _ in range(_ROUNDS):
            where = await self.address_of(node)
            if where is None:
                return
            state = await self.state()
            for method, kind in (("Publisher", state.publishers), ("Subscriber", state.subscribers)):
                for topic, nodes in kind.items():
                    if node in nodes:
                        await self.call(f"unregister{method}", node, topic, where)
            for service, nodes in state.services.items():
                if node in nodes:
                    served_at = await self.call("lookupService", self.caller, service)
                    await self.call("unregisterService", node, service, served_at)
            await self.call("unsubscribeParam", node, where, _PARAMETER)
            if await self.address_of(node) is None:
                return
            await self._unsubscribe_parameters(node, where)
        raise BackendError(f"the ROS master still lists {node}, which has ended")

    async def _unsubscribe_parameters(self, node: str, where: str) -> None:
        """Remove the subscriptions to parameters of a node, which the master does not list.

        They go when the node is registered anew from elsewhere. The master then has the process at the old address
        shut down, so nothing may listen there.
        """
        host, port, _ = rpc.address(where)
        try:
            async with within(PROBE):
                _, writer = await asyncio.open_connection(host, port)
        except ConnectionRefusedError:
            service, nowhere = f"{node}/gone", "http://127.0.0.1:1/"
            await self.call("registerService", node, service, "rosrpc://127.0.0.1:1", nowhere)
            await self.call("unregisterService", node, service, "rosrpc://127.0.0.1:1")
        except (OSError, asyncio.TimeoutError):
            pass
        else:
            writer.close()

    async def is_running(self, node: str) -> bool:
        """Return whether a node of that name runs; what a dead one has left is withdrawn.

        Another node may listen at its address by now. ROS's Python nodes give their names; where one does not, the
        master's word counts.
        """
        where = await self.address_of(node)
        if where is None:
            return False
        try:
            answer = await rpc.call(where, "getName", self.caller, timeout=PROBE)
        except CallTimeout:
            return True  # it may be frozen, which is not dead
        except Unreachable:
            await self.unregister(node)
            return False
        except BackendError:
            return True
        if isinstance(answer, list) and answer[:1] == [1] and answer[-1] != node:
            await self.unregister(node)
            return False
        return True
