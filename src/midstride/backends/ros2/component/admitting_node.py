"""A node whose services and ROS actions handle admitted requests only (:mod:`midstride.node.request_admission`).

The instances of a role have one node name, so every request to the node reaches each of them.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message

from midstride.backends.ros2.names import service_name
from midstride.node.request_admission import PassableRequest, RequestAdmission


class AdmittingNode(Node):  # type: ignore[misc]
    """rclpy's node; ``admission`` decides for all its services and action servers, whenever they are made."""

    def __init__(self, name: str, admission: RequestAdmission, **options: Any) -> None:
        self._admission = admission
        super().__init__(name, **options)
        for service in self.services:  # those that ROS itself has made
            guard_service(service, service_name(self, service), admission, self._later)

    def create_service(self, *arguments: Any, **options: Any) -> Any:
        service = super().create_service(*arguments, **options)
        guard_service(service, service_name(self, service), self._admission, self._later)
        return service

    def destroy_service(self, service: Any) -> bool:
        """Also end the handling of requests that are passed on to it."""
        handlers = self._admission.passed_handlers
        for name in [name for name, handler in handlers.items() if handler is getattr(service, "handle_passed", None)]:
            del handlers[name]
        return bool(super().destroy_service(service))

    def add_waitable(self, waitable: Any) -> None:
        if _is_action(waitable, "ActionServer"):
            from midstride.backends.ros2.component.action_endpoints import guard_action

            guard_action(waitable, self._admission, self._later)
        super().add_waitable(waitable)

    def remove_waitable(self, waitable: Any) -> None:
        super().remove_waitable(waitable)
        if _is_action(waitable, "ActionServer"):
            waitable.admitted_goals.left()

    def destroy_node(self) -> None:
        """Also end its ROS actions, which rclpy leaves to their owner.

        One that is left keeps the node, and so the process, from leaving ROS: others have the node in their graph until
        the lease of the process has expired.
        """
        for waitable in list(self.waitables):
            if _is_action(waitable, "ActionClient", "ActionServer"):
                waitable.destroy()
        super().destroy_node()

    def _later(self, work: Callable[[], Any]) -> None:
        """Have the executor call ``work``; from any thread."""
        if (executor := self.executor) is not None:
            executor.create_task(work)


def _is_action(waitable: Any, *classes: str) -> bool:
    """Return whether ``waitable`` is of one of these classes of ``rclpy.action``.

    On jazzy that brings in NumPy, which takes a third of the time of a component's imports: a process without ROS
    actions imports neither.
    """
    module = sys.modules.get("rclpy.action")
    return isinstance(waitable, tuple(getattr(module, name, ()) for name in classes))


def guard_service(
    service: Any, name: str, admission: RequestAdmission, later: Callable[[Callable[[], Any]], None]
) -> None:
    """Have rclpy's ``service`` of the full ``name`` call its callback, and answer, for what ``admission`` admits.

    The executor passes a request's identity to `send_response` only, so the callback is called there.
    """
    serve, send = service.callback, service.send_response
    types = service.srv_type

    def handle(identity: str, request: Any, response: Any, respond: Callable[[Any], object]) -> None:
        admission.handle(identity, lambda: serve(request, response), respond, later)

    def answer(pending: tuple[Any, Any], header: Any) -> None:
        request, response = pending
        # The client's own time and count: the same at every server.
        identity = f"{header.source_timestamp} {header.request_id.sequence_number}"

        def respond(result: Any) -> None:
            if result is not None:
                send(result, header)

        handle_it = partial(handle, identity, request, response, respond)
        passable = PassableRequest(
            name,
            lambda: serialize_message(request),
            lambda data: later(lambda: send(deserialize_message(data, types.Response), header)),
        )
        waited = max(0, time.time_ns() - header.received_timestamp) / 1e9 if header.received_timestamp else 0.0
        if admission.admit(identity, lambda: later(handle_it), passable, service=name, waited=waited):
            handle_it()

    def handle_passed(identity: str, data: bytes, respond: Callable[[bytes | None], object]) -> None:
        request = deserialize_message(data, types.Request)
        handle_it = partial(
            handle,
            identity,
            request,
            types.Response(),
            lambda result: respond(None if result is None else serialize_message(result)),
        )
        later(handle_it)

    service.callback = lambda request, response: (request, response)
    service.send_response = answer
    service.handle_passed = handle_passed
    admission.passed_handlers[name] = handle_passed
