"""The ROS actions of a component: those that are ports, and how all are admitted (:mod:`.admitting_node`).

Imported where there is one (:mod:`.admitting_node` has the reason). All of it runs on the data thread.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any, Final

from action_msgs.msg import GoalStatus
from action_msgs.srv import CancelGoal
from rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse
from rclpy.serialization import deserialize_message, serialize_message

from midstride.backends.admitted_goals import MANY, AdmittedGoals, GoalRequest
from midstride.backends.retiring_server import RetiringServer
from midstride.backends.ros2.component.service_endpoints import RosCaller
from midstride.backends.sent_goals import hand_on
from midstride.node.component_host import GoalAnswers
from midstride.node.request_admission import RequestAdmission

# The identity of a request to cancel goals that names none.
NO_GOAL: Final = bytes(16).hex()


class RosActionServer(RetiringServer[GoalAnswers]):
    """The ROS action ``name`` of ``node``: in the graph until its goals have ended."""

    def __init__(
        self,
        node: Any,
        group: Any,
        name: str,
        type_: type,
        answers: GoalAnswers,
        *,
        admission: RequestAdmission,
        later: Callable[[Callable[[], None]], object],
        gone: Callable[[RosActionServer], object],
    ) -> None:
        super().__init__(name, type_, answers, admission, later)
        self._gone = gone
        self.service = ActionServer(
            node,
            type_,
            name,
            self._execute,
            callback_group=group,
            goal_callback=self._accepts,
            cancel_callback=self._cancels,
        )
        self.service.timed_as = name

    async def _accepts(self, goal: Any) -> GoalResponse:
        accepted = not self.retired and await self.answer.accepts(goal)
        return GoalResponse.ACCEPT if accepted else GoalResponse.REJECT

    async def _cancels(self, goal: Any) -> CancelResponse:
        return CancelResponse.ACCEPT if await self.answer.cancels(goal) else CancelResponse.REJECT

    async def _execute(self, goal: Any) -> Any:
        return await self._in_time(self.answer.execute(goal))

    def _leave(self) -> None:
        self.service.destroy()
        self._gone(self)


class RosActionClient(RosCaller):
    """A client of the ROS action ``name``. ``accepted`` is called with the handle of each accepted goal."""

    def __init__(self, node: Any, group: Any, name: str, type_: type, accepted: Callable[[Any], None]) -> None:
        self.client = ActionClient(node, type_, name, callback_group=group)
        super().__init__(node, self.client.server_is_ready)
        self._accepted = accepted

    def call(self, request: Any, feedback: Callable[[Any], object] | None = None) -> Any:
        given = self.unsent()
        hand_on(self.client.send_goal_async(request, feedback_callback=feedback), given, lambda it: it, self._accepted)
        return given

    def destroy(self) -> None:
        self.client.destroy()


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
    server.admitted_goals = goals


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
