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

from midstride.node.request_admission import RequestAdmission


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

    def answer(pending: tuple[Any, Any], header: Any) -> None:
        request, response = pending
        # The client's own time and count: the same at every server.
        identity = f"{header.source_timestamp} {header.request_id.sequence_number}"

        def handle() -> None:
            awaited = False
            try:
                result = serve(request, response)
                awaited = inspect.isawaitable(result)
                if not awaited:
                    send(result, header)
            finally:
                if not awaited:
                    admission.finished(identity)
            if awaited:
                later(partial(finish, result))

        async def finish(result: Any) -> None:
            try:
                send(await result, header)
            finally:
                admission.finished(identity)

        if admission.admit(identity, lambda: later(handle)):
            handle()

    service.callback = lambda request, response: (request, response)
    service.send_response = answer


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
