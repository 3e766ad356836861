"""A node of this process that calls the services of ROS 2 by which nodes and containers are changed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from .streams import PATIENCE, SwapFailed


class Services:
    """Calls services, and waits for their answers; each client is kept."""

    def __init__(self, node: Any, executor: Any) -> None:
        self._node, self._executor = node, executor
        self._clients: dict[str, Any] = {}

    def call(self, type_: Any, service: str, request: Any) -> Any:
        """The answer of a service whose answers say whether it was a success. Raises SwapFailed if not."""
        if service not in self._clients:
            self._clients[service] = self._node.create_client(type_, service)
            if not self._clients[service].wait_for_service(timeout_sec=PATIENCE):
                raise SwapFailed(f"{service} is not there")
        future = self._clients[service].call_async(request)
        self._executor.spin_until_future_complete(future, timeout_sec=PATIENCE)
        if not (future.done() and future.result().success):
            raise SwapFailed(f"{service} has failed: {future.result() if future.done() else 'no answer'}")
        return future.result()

    def change(self, node: str, transition: str) -> None:
        """Change the state of a lifecycle node: `configure`, `activate` or `deactivate`."""
        from lifecycle_msgs.msg import Transition
        from lifecycle_msgs.srv import ChangeState

        id_ = getattr(Transition, f"TRANSITION_{transition.upper()}")
        self.call(ChangeState, f"/{node}/change_state", ChangeState.Request(transition=Transition(id=id_)))


@contextmanager
def services() -> Iterator[Services]:
    """What calls services, while inside."""
    import rclpy

    context = rclpy.Context()
    rclpy.init(context=context, args=[])
    node = rclpy.create_node("changer", context=context)
    executor = rclpy.executors.SingleThreadedExecutor(context=context)
    executor.add_node(node)
    try:
        yield Services(node, executor)
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown(context=context)
