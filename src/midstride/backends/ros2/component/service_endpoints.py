"""The services of servers and clients that are ports; they are admitted as all others (:mod:`.admitting_node`).

All of it runs on the data thread, unless stated.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from typing import Any, Final

from rclpy.exceptions import InvalidHandle
from rclpy.qos import QoSProfile, qos_profile_services_default
from rclpy.task import Future

from midstride.backends.retiring_server import RetiringServer
from midstride.backends.ros2.names import service_name
from midstride.node.request_admission import RequestAdmission

# How many requests, or responses, fit into the queue of an endpoint. Every client of a service receives the responses
# to all of them, and the middleware drops what does not fit.
DEPTH: Final = 200


def _deep_queue() -> QoSProfile:
    profile = copy(qos_profile_services_default)
    profile.depth = DEPTH
    return profile


class RosServer(RetiringServer[Callable[[Any, Any], Any]]):
    """The service ``name`` of ``node``. ``gone`` is called when it has left the graph."""

    def __init__(
        self,
        node: Any,
        group: Any,
        name: str,
        type_: type,
        answer: Callable[[Any, Any], Any],
        *,
        admission: RequestAdmission,
        later: Callable[[Callable[[], None]], object],
        gone: Callable[[RosServer], object],
    ) -> None:
        super().__init__(name, type_, answer, admission, later)
        self._node, self._gone = node, gone
        self.service = node.create_service(type_, name, self._serve, qos_profile=_deep_queue(), callback_group=group)

    def _serve(self, request: Any, response: Any) -> Any:
        return self._in_time(self.answer(request, response))

    def _answer_waiting(self) -> None:
        """Answer as the executor would."""
        service, types = self.service, self.service.srv_type
        while True:
            with service.handle:
                request, header = service.handle.service_take_request(types.Request)
            if header is None:
                return
            service.send_response(service.callback(request, types.Response()), header)

    def _leave(self) -> None:
        self.admission.passed_handlers.pop(service_name(self._node, self.service), None)
        self._node.destroy_service(self.service)
        self._gone(self)


class RosCaller:
    """One side of a service or ROS action, of ``node``. ``is_ready`` says whether a server has been discovered."""

    def __init__(self, node: Any, is_ready: Callable[[], bool]) -> None:
        self._node, self._is_ready = node, is_ready

    def unsent(self) -> Future[Any]:
        return Future(executor=self._node.executor)

    def abandon(self, future: Any, error: Exception) -> None:
        if not future.done():
            future.set_exception(error)
            # Kilted's executor runs older tasks first: one that awaits this future would wait for the next event.
            if (executor := self._node.executor) is not None:
                executor.wake()

    def matched(self) -> int:
        try:
            return int(self._is_ready())
        except InvalidHandle:
            return 0

    def publisher_ids(self) -> None:
        return None


class RosClient(RosCaller):
    """A client of the service ``name``."""

    def __init__(self, node: Any, group: Any, name: str, type_: type, destroy: Callable[[Any], object]) -> None:
        self.client = node.create_client(type_, name, qos_profile=_deep_queue(), callback_group=group)
        super().__init__(node, self.client.service_is_ready)
        self._destroy = destroy

    def call(self, request: Any, feedback: Callable[[Any], object] | None = None) -> Any:
        return self.client.call_async(request)

    def abandon(self, future: Any, error: Exception) -> None:
        if not future.done():
            self.client.remove_pending_request(future)
        super().abandon(future, error)

    def destroy(self) -> None:
        self._destroy(self.client)
