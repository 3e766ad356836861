"""A node whose services and ROS actions are behind a gate (:mod:`midstride.node.service_gate`).

The instances of a role have one node name, so every request to the node reaches each of them.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from rclpy.action import ActionServer
from rclpy.node import Node

from midstride.node.service_gate import ServiceGate


class GatedNode(Node):  # type: ignore[misc]
    """rclpy's node; whatever services and action servers it gets, at any time, are behind ``gate``."""

    def __init__(self, name: str, gate: ServiceGate, **options: Any) -> None:
        self._gate = gate
        super().__init__(name, **options)
        for service in self.services:  # those that ROS itself has made
            guard_service(service, gate, self._later)

    def create_service(self, *arguments: Any, **options: Any) -> Any:
        service = super().create_service(*arguments, **options)
        guard_service(service, self._gate, self._later)
        return service

    def add_waitable(self, waitable: Any) -> None:
        if isinstance(waitable, ActionServer):
            guard_action(waitable, self._gate, self._later)
        super().add_waitable(waitable)

    def _later(self, work: Callable[[], Any]) -> None:
        """Have the executor call ``work``; from any thread."""
        if (executor := self.executor) is not None:
            executor.create_task(work)


def guard_service(service: Any, gate: ServiceGate, later: Callable[[Callable[[], Any]], None]) -> None:
    """Have rclpy's ``service`` call its callback, and answer, for what ``gate`` admits.

    The executor passes a request's identity to `send_response` only, so the callback is called there.
    """
    serve, send = service.callback, service.send_response

    def answer(pending: tuple[Any, Any], header: Any) -> None:
        request, response = pending

        def handle() -> None:
            result = serve(request, response)
            if not inspect.isawaitable(result):
                send(result, header)
                return

            async def finish() -> None:
                send(await result, header)

            later(finish)

        # The client's own time and count: the same at every server.
        if gate.admit(f"{header.source_timestamp} {header.request_id.sequence_number}", lambda: later(handle)):
            handle()

    service.callback = lambda request, response: (request, response)
    service.send_response = answer


def guard_action(server: Any, gate: ServiceGate, later: Callable[[Callable[[], Any]], None]) -> None:
    """Have rclpy's action ``server`` handle the requests that ``gate`` admits."""
    execute = server.execute

    def admits(kind: str, entry: Any) -> bool:
        if kind == "expired":  # goals of this server, not a request
            return True
        header, request = entry
        goal = request.goal_info.goal_id if kind == "cancel" else request.goal_id
        identity = f"{kind} {bytes(goal.uuid).hex()} {header.sequence_number}"

        async def handle() -> None:
            await execute({kind: entry})

        return gate.admit(identity, lambda: later(handle))

    async def execute_admitted(taken: dict[str, Any]) -> None:
        await execute({kind: entry for kind, entry in taken.items() if admits(kind, entry)})

    server.execute = execute_admitted
