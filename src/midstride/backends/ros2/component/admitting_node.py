"""A node whose services and ROS actions handle admitted requests only (:mod:`midstride.node.request_admission`).

The instances of a role have one node name, so every request to the node reaches each of them.
"""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

from action_msgs.msg import GoalStatus
from action_msgs.srv import CancelGoal
from rclpy.action import ActionClient, ActionServer
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message

from midstride.backends.admitted_goals import MANY, AdmittedGoals, GoalRequest
from midstride.node.request_admission import PassableRequest, RequestAdmission

# The identity of a request to cancel goals that names none.
NO_GOAL: Final = bytes(16).hex()


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
            service.service_name,
            lambda: serialize_message(request),
            lambda data: later(lambda: send(deserialize_message(data, types.Response), header)),
        )
        waited = max(0, time.time_ns() - header.received_timestamp) / 1e9 if header.received_timestamp else 0.0
        if admission.admit(identity, lambda: later(handle_it), passable, service=service.service_name, waited=waited):
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
    """Have rclpy's action ``server`` handle the requests that ``admission`` admits, and those about its own goals."""
    execute = server.execute
    goals = AdmittedGoals(_RosGoals(server, execute), admission, later)

    async def execute_admitted(taken: dict[str, Any]) -> None:
        for kind, entry in taken.items():
            if kind != "expired":
                await goals.handle(_goal_request(kind, entry))
                continue
            await execute({kind: entry})  # goals of this server: that is no request
            for info in entry:
                admission.goals.expired(_uuid(info.goal_id))

    server.execute = execute_admitted


def _goal_request(kind: str, entry: Any) -> GoalRequest:
    header, request = entry
    match kind:
        case "goal":
            goal = _uuid(request.goal_id)
            return GoalRequest("goal", f"goal {goal} {header.sequence_number}", goal, entry)
        case "result":
            goal = _uuid(request.goal_id)
            return GoalRequest("result", f"result {goal} {header.sequence_number}", goal, entry)
    goal, stamp = _uuid(request.goal_info.goal_id), request.goal_info.stamp
    identity = f"cancel {goal} {stamp.sec}.{stamp.nanosec} {header.sequence_number}"
    many = goal == NO_GOAL or stamp.sec or stamp.nanosec
    return GoalRequest("cancel", identity, MANY if many else goal, entry)


@dataclass(frozen=True)
class _RosGoals:
    """The goals of rclpy's action ``server``; ``execute`` is its own method. Implements GoalServer."""

    server: Any
    execute: Callable[[dict[str, Any]], Awaitable[None]]

    def _result(self, goal: str) -> Any:
        return self.server._result_futures.get(bytes.fromhex(goal))

    @property
    def timed_as(self) -> str:
        return str(getattr(self.server, "timed_as", ""))

    async def accept(self, entry: Any) -> None:
        await self.execute({"goal": entry})

    def knows(self, goal: str) -> bool:
        return self._result(goal) is not None

    def when_ended(self, goal: str, function: Callable[[Any], object]) -> None:
        def done(future: Any) -> None:
            if (response := future.result()) is not None:
                function(response)

        self._result(goal).add_done_callback(done)

    async def give_result(self, entry: Any) -> None:
        await self.execute({"result": entry})

    def give_kept(self, entry: Any, response: bytes) -> None:
        types = self.server.action_type.Impl.GetResultService
        self.server._handle.send_result_response(entry[0], deserialize_message(response, types.Response))

    async def cancel(self, entry: Any, respond: Callable[[Any], object]) -> None:
        """Do what rclpy does with a request to cancel goals, and call ``respond`` instead of sending the response."""
        request = CancelGoal.Request() if entry is None else entry[1]
        await type(self.server)._execute_cancel_request(_Cancelling(self.server, respond), (None, request))

    def give_cancelled(self, entry: Any, response: Any, added: bytes | None) -> bool:
        if added is not None:
            _add(response, deserialize_message(added, CancelGoal.Response))
        self.server._handle.send_cancel_response(entry[0], response)
        return bool(response.return_code != CancelGoal.Response.ERROR_UNKNOWN_GOAL_ID)

    def is_cancelled(self, response: Any) -> bool:
        return bool(response.status == GoalStatus.STATUS_CANCELED)

    def serialized(self, response: Any) -> bytes:
        return bytes(serialize_message(response))


def _uuid(goal_id: Any) -> str:
    return bytes(goal_id.uuid).hex()


def _add(response: Any, added: Any) -> None:
    """Add the goals that another instance has cancelled to a response."""
    known = {_uuid(info.goal_id) for info in response.goals_canceling}
    more = [info for info in added.goals_canceling if _uuid(info.goal_id) not in known]
    if more:
        response.goals_canceling = [*response.goals_canceling, *more]
        response.return_code = CancelGoal.Response.ERROR_NONE


class _Cancelling:
    """A ``server`` of rclpy as its handling of a request to cancel goals sees it: ``respond`` gets the response."""

    def __init__(self, server: Any, respond: Callable[[Any], object]) -> None:
        self._server = server
        self._handle = _CancelHandle(server._handle, respond)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._server, name)


class _CancelHandle:
    def __init__(self, handle: Any, respond: Callable[[Any], object]) -> None:
        self.process_cancel_request = handle.process_cancel_request
        self._respond = respond

    def send_cancel_response(self, header: None, response: Any) -> None:
        self._respond(response)
