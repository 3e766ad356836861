"""A node whose services and ROS actions handle admitted requests only (:mod:`midstride.node.request_admission`).

The instances of a role have one node name, so every request to the node reaches each of them.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.action import ActionClient, ActionServer
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message

from midstride.node.request_admission import PassableRequest, RequestAdmission


class AdmittingNode(Node):  # type: ignore[misc]
    """rclpy's node; ``admission`` decides for all its services and action servers, whenever they are made."""

    def __init__(self, name: str, admission: RequestAdmission, **options: Any) -> None:
        self._admission = admission
        super().__init__(name, **options)
        for service in self.services:  # those that ROS itself has made
            guard_service(service, admission, self._later)

    def create_service(self, *arguments: Any, **options: Any) -> Any:
        service = super().create_service(*arguments, **options)
        guard_service(service, self._admission, self._later)
        return service

    def destroy_service(self, service: Any) -> bool:
        """Also end the handling of requests that are passed on to it."""
        handlers = self._admission.passed_handlers
        for name in [name for name, handler in handlers.items() if handler is getattr(service, "handle_passed", None)]:
            del handlers[name]
        return bool(super().destroy_service(service))

    def add_waitable(self, waitable: Any) -> None:
        if isinstance(waitable, ActionServer):
            guard_action(waitable, self._admission, self._later)
        super().add_waitable(waitable)

    def destroy_node(self) -> None:
        """Also end its ROS actions, which rclpy leaves to their owner.

        One that is left keeps the node, and so the process, from leaving ROS: others have the node in their graph until
        the lease of the process has expired.
        """
        for waitable in list(self.waitables):
            if isinstance(waitable, (ActionClient, ActionServer)):
                waitable.destroy()
        super().destroy_node()

    def _later(self, work: Callable[[], Any]) -> None:
        """Have the executor call ``work``; from any thread."""
        if (executor := self.executor) is not None:
            executor.create_task(work)


def guard_service(service: Any, admission: RequestAdmission, later: Callable[[Callable[[], Any]], None]) -> None:
    """Have rclpy's ``service`` call its callback, and answer, for what ``admission`` admits.

    The executor passes a request's identity to `send_response` only, so the callback is called there.
    """
    serve, send = service.callback, service.send_response
    types = service.srv_type

    def handle(identity: str, request: Any, response: Any, respond: Callable[[Any], object]) -> None:
        """Call the callback, and ``respond`` with its result: with None where it raises."""
        awaited, result = False, None
        try:
            result = serve(request, response)
            awaited = inspect.isawaitable(result)
        finally:
            if not awaited:
                answered(identity, result, respond)
        if awaited:
            later(partial(finish, identity, result, respond))

    async def finish(identity: str, awaitable: Any, respond: Callable[[Any], object]) -> None:
        result = None
        try:
            result = await awaitable
        finally:
            answered(identity, result, respond)

    def answered(identity: str, result: Any, respond: Callable[[Any], object]) -> None:
        try:
            respond(result)
        finally:
            admission.finished(identity)

    def answer(pending: tuple[Any, Any], header: Any) -> None:
        request, response = pending
        # The client's own time and count: the same at every server.
        identity = f"{header.source_timestamp} {header.request_id.sequence_number}"

        def respond(result: Any) -> None:
            if result is not None:
                send(result, header)

        handle_it = partial(handle, identity, request, response, respond)
        passable = PassableRequest(
            service.service_name,
            lambda: serialize_message(request),
            lambda data: later(lambda: send(deserialize_message(data, types.Response), header)),
        )
        if admission.admit(identity, lambda: later(handle_it), passable):
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
    admission.passed_handlers[service.service_name] = handle_passed


def guard_action(server: Any, admission: RequestAdmission, later: Callable[[Callable[[], Any]], None]) -> None:
    """Have rclpy's action ``server`` handle the requests that ``admission`` admits."""
    execute = server.execute

    def identity(kind: str, entry: Any) -> str:
        header, request = entry
        goal = request.goal_info.goal_id if kind == "cancel" else request.goal_id
        return f"{kind} {bytes(goal.uuid).hex()} {header.sequence_number}"

    def admits(kind: str, entry: Any) -> bool:
        # Expired are goals of this server: that is no request.
        if kind == "expired":
            return True
        return admission.admit(identity(kind, entry), lambda: later(partial(handle, {kind: entry})))

    async def handle(taken: dict[str, Any]) -> None:
        try:
            await execute(taken)
        finally:
            for kind, entry in taken.items():
                if kind != "expired":
                    admission.finished(identity(kind, entry))

    async def execute_admitted(taken: dict[str, Any]) -> None:
        await handle({kind: entry for kind, entry in taken.items() if admits(kind, entry)})

    server.execute = execute_admitted
