"""A node whose services and ROS actions handle admitted requests only (:mod:`midstride.node.request_admission`).

The instances of a role have one node name, so every request to the node reaches each of them.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any, Final

from action_msgs.msg import GoalStatus
from action_msgs.srv import CancelGoal
from rclpy.action import ActionClient, ActionServer
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message

from midstride.node.request_admission import PassableRequest, RequestAdmission, Turn

# The identity of a request to cancel goals that names none; and what stands for several goals.
NO_GOAL: Final = bytes(16).hex()
MANY: Final = ""


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
    goals = admission.goals
    execute = server.execute

    async def dispatch(kind: str, entry: Any) -> None:
        """Handle ``entry``, or hold it: then it comes here again."""
        if kind == "expired":  # goals of this server: that is no request
            await execute({kind: entry})
            for info in entry:
                goals.expired(_uuid(info.goal_id))
            return
        header, request = entry
        if kind == "goal":
            goal = _uuid(request.goal_id)
            identity = f"goal {goal} {header.sequence_number}"
            accept_it, timed = partial(accept, identity, goal, entry), getattr(server, "timed_as", "")
            if admission.admit(identity, lambda: later(accept_it), asks_for=goal, service=timed):
                await accept(identity, goal, entry)
            return
        if kind == "result":
            goal = _uuid(request.goal_id)
            identity = f"result {goal} {header.sequence_number}"
        else:
            goal, stamp = _uuid(request.goal_info.goal_id), request.goal_info.stamp
            identity = f"cancel {goal} {stamp.sec}.{stamp.nanosec} {header.sequence_number}"
            if goal == NO_GOAL or stamp.sec or stamp.nanosec:
                goal = MANY
        match admission.turn(identity, goal, lambda: later(partial(dispatch, kind, entry))):
            case Turn.WAIT:
                return
            case Turn.ADD:
                await cancel(request, lambda response: goals.add_list(identity, serialize_message(response)))
            case Turn.ANSWER if kind == "result":
                await give_result(identity, goal, entry)
            case Turn.ANSWER if goal == MANY and admission.predecessor_has_goals:
                answer = partial(answer_cancel, identity, header, request)
                goals.await_list(identity, lambda added: later(partial(answer, added)))
            case Turn.ANSWER:
                await answer_cancel(identity, header, request, None)

    async def accept(identity: str, goal: str, entry: Any) -> None:
        try:
            await execute({"goal": entry})
            result = server._result_futures.get(bytes.fromhex(goal))
            if result is not None and goals.accepted(goal, cancel_all):
                result.add_done_callback(partial(ended, goal))
        finally:
            admission.finished(identity)

    def ended(goal: str, result: Any) -> None:
        if (response := result.result()) is not None:
            cancelled = response.status == GoalStatus.STATUS_CANCELED
            goals.ended(goal, lambda: serialize_message(response), cancelled=cancelled)

    async def give_result(identity: str, goal: str, entry: Any) -> None:
        header, _ = entry
        try:
            result = server._result_futures.get(bytes.fromhex(goal))
            if result is not None:
                goals.fetched(goal)
                await execute({"result": entry})
            elif (kept := goals.kept(goal)) is not None:
                server._handle.send_result_response(
                    header, deserialize_message(kept, server.action_type.Impl.GetResultService.Response)
                )
            else:
                goals.not_known()
                await execute({"result": entry})
        finally:
            admission.finished(identity)

    async def answer_cancel(identity: str, header: Any, request: Any, added: bytes | None) -> None:
        """Cancel goals, and respond also with those that the other instance has cancelled (``added``)."""

        def respond(response: Any) -> None:
            if added is not None:
                _add(response, deserialize_message(added, CancelGoal.Response))
            if response.return_code == CancelGoal.Response.ERROR_UNKNOWN_GOAL_ID:
                goals.not_known()
            server._handle.send_cancel_response(header, response)

        try:
            await cancel(request, respond)
        finally:
            admission.finished(identity)

    async def cancel(request: Any, respond: Callable[[Any], object]) -> None:
        """Do what rclpy does with a request to cancel goals, and call ``respond`` instead of sending the response."""
        await type(server)._execute_cancel_request(_Cancelling(server, respond), (None, request))

    def cancel_all() -> None:
        later(partial(cancel, CancelGoal.Request(), lambda response: None))

    async def execute_admitted(taken: dict[str, Any]) -> None:
        for kind, entry in taken.items():
            await dispatch(kind, entry)

    server.execute = execute_admitted


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
