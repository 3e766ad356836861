"""The servers and clients of a simulated component's ports. All of it runs on its data thread, unless stated."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any, Final

from midstride.backends.admitted_goals import MANY, AdmittedGoals, GoalRequest
from midstride.backends.retiring_server import RetiringServer
from midstride.backends.sent_goals import hand_on
from midstride.backends.simulator.message_copy import copied
from midstride.backends.simulator.service_network import RequestKind, ServiceEnd, SimulatedRequest
from midstride.backends.simulator.simulated_future import SimulatedFuture
from midstride.node.component_host import GoalAnswers
from midstride.node.request_admission import PassableRequest, RequestAdmission

# States of a goal, as `action_msgs/msg/GoalStatus` has them; and how a request is answered that cancels no goal, or is
# about one that is not known, as `action_msgs/srv/CancelGoal` has it.
UNKNOWN: Final = 0
ACCEPTED: Final = 1
EXECUTING: Final = 2
SUCCEEDED: Final = 4
CANCELED: Final = 5
ABORTED: Final = 6
REJECTED: Final = 1
UNKNOWN_GOAL: Final = 2


class SimulatedServer(RetiringServer[Callable[[Any, Any], Any]]):
    """A service of a process. ``gone`` is called when it has left the graph."""

    def __init__(
        self,
        end: ServiceEnd,
        name: str,
        answer: Callable[[Any, Any], Any],
        admission: RequestAdmission,
        later: Callable[[Callable[[], Any]], None],
        gone: Callable[[], object],
    ) -> None:
        super().__init__(name, end.type, answer, admission, later)
        self.end = end
        self._gone = gone
        # Those that have arrived, and wait for the data thread.
        self._queue: deque[SimulatedRequest] = deque()
        admission.passed_handlers[end.name] = self._handle_passed
        end.network.servers.append(self)

    def arrive(self, request: SimulatedRequest) -> None:
        """On the loop. One that has left the graph meanwhile receives nothing."""
        if self in self.end.network.servers:
            self._queue.append(request)
            self.end.network.observer.on_received(request, self.end.owner)
            self.end.owner.enqueue(self._take)

    def _take(self) -> None:
        if self._queue:
            self._admit(self._queue.popleft())

    def _answer_waiting(self) -> None:
        while self._queue:
            self._take()

    def _admit(self, request: SimulatedRequest) -> None:
        network, owner = self.end.network, self.end.owner

        def respond(response: Any) -> None:
            if response is not None and not owner.dead:
                network.respond(request, owner, response)

        handle = partial(self._handle, request, respond)
        passable = PassableRequest(
            self.end.name,
            request.identity.encode,
            lambda data: self._later(lambda: respond(request.passed)),
        )
        if self.admission.admit(request.identity, lambda: self._later(handle), passable, service=self.end.name):
            handle()

    def _handle(self, request: SimulatedRequest, respond: Callable[[Any], object]) -> None:
        self.end.network.observer.on_executed(request, self.end.owner)
        response = self.type.Response()  # type: ignore[attr-defined]
        self.admission.handle(
            request.identity,
            lambda: self._in_time(self.answer(copied(request.request), response)),
            respond,
            self._later,
        )

    def _handle_passed(self, identity: str, data: bytes, respond: Callable[[bytes | None], object]) -> None:
        """On the loop: a request that only the predecessor has received."""
        request = self.end.network.waiting.get(data.decode())

        def answered(response: Any) -> None:
            if request is not None:
                request.passed = copied(response)
            respond(None if response is None else data)

        if request is None:  # its client waits no longer
            self.admission.finished(identity)
            respond(None)
        else:
            self._later(partial(self._handle, request, answered))

    def _leave(self) -> None:
        self.admission.passed_handlers.pop(self.end.name, None)
        self.end.network.servers.remove(self)
        self._gone()


class SimulatedGoal:
    """A goal that a server executes: what ``function(goal)`` of an action server is called with, as rclpy has it."""

    def __init__(self, server: SimulatedActionServer, sent: SimulatedRequest) -> None:
        self.goal_id = sent.identity
        self.request = copied(sent.request.goal)
        self.status = EXECUTING
        self.is_cancel_requested = False
        self.result: Any = None
        self._waiting: list[Callable[[Any], object]] = []
        self._server, self._sent = server, sent

    @property
    def is_active(self) -> bool:
        """True until it has ended."""
        return self.status == EXECUTING

    def publish_feedback(self, feedback: Any) -> None:
        """Send feedback to the client."""
        end, message = self._server.end, copied(feedback)
        callback = self._sent.request.feedback
        if callback is not None:
            words = SimpleNamespace(goal_id=self.goal_id, feedback=message)
            end.network.send_message(self._sent.client, end.owner, lambda: callback(words))

    def succeed(self) -> None:
        self.status = SUCCEEDED

    def abort(self) -> None:
        self.status = ABORTED

    def canceled(self) -> None:
        self.status = CANCELED

    def end(self, result: Any) -> None:
        """Note that the function of the goal has returned: one that has set no status has aborted."""
        self.status = ABORTED if self.is_active else self.status
        self.result = result
        self._server.end.network.observer.on_ended(self.goal_id, self._server.end.owner, self._response())
        for function in self._waiting:
            function(self._response())

    def when_ended(self, function: Callable[[Any], object]) -> None:
        """Have ``function`` called with the response that has the result."""
        if self.is_active or self.result is None:
            self._waiting.append(function)
        else:
            function(self._response())

    def _response(self) -> Any:
        return SimpleNamespace(status=self.status, result=self.result)


class SimulatedActionServer(RetiringServer[GoalAnswers]):
    """A ROS action of a process: in the graph until its goals have ended. ``gone`` is called when it has left.

    Implements :class:`midstride.backends.admitted_goals.GoalServer`.
    """

    def __init__(
        self,
        end: ServiceEnd,
        name: str,
        answers: GoalAnswers,
        admission: RequestAdmission,
        later: Callable[[Callable[[], Any]], None],
        gone: Callable[[], object],
    ) -> None:
        super().__init__(name, end.type, answers, admission, later)
        self.end = end
        self._gone = gone
        self._goals: dict[str, SimulatedGoal] = {}
        self._requests = AdmittedGoals(self, admission, later)
        end.network.servers.append(self)

    def arrive(self, request: SimulatedRequest) -> None:
        """On the loop. One that has left the graph meanwhile receives nothing."""
        if self not in self.end.network.servers or request.kind == "request":
            return
        goal = request.identity if request.kind == "goal" else request.request
        self._later(partial(self._requests.handle, GoalRequest(request.kind, request.identity, goal, request)))

    @property
    def timed_as(self) -> str:
        return self.end.name

    async def accept(self, entry: SimulatedRequest) -> None:
        end = self.end
        end.network.observer.on_executed(entry, end.owner)
        accepted = not self.retired and await self.answer.accepts(copied(entry.request.goal))
        end.network.respond(entry, end.owner, SimpleNamespace(accepted=accepted))
        if accepted:
            goal = self._goals[entry.identity] = SimulatedGoal(self, entry)
            self._later(partial(self._execute, goal))

    async def _execute(self, goal: SimulatedGoal) -> None:
        result = None
        try:
            result = await self._in_time(self.answer.execute(goal))
        except Exception:  # which the port has reported
            goal.abort()
        goal.end(self.type.Result() if result is None else result)  # type: ignore[attr-defined]

    def knows(self, goal: str) -> bool:
        return goal in self._goals

    def when_ended(self, goal: str, function: Callable[[Any], object]) -> None:
        self._goals[goal].when_ended(function)

    async def give_result(self, entry: SimulatedRequest) -> None:
        end = self.end
        end.network.observer.on_executed(entry, end.owner)
        respond = partial(end.network.respond, entry, end.owner)
        if (goal := self._goals.get(entry.request)) is None:
            respond(SimpleNamespace(status=UNKNOWN, result=self.type.Result()))  # type: ignore[attr-defined]
        else:
            goal.when_ended(respond)

    def give_kept(self, entry: SimulatedRequest, response: bytes) -> None:
        end = self.end
        end.network.observer.on_executed(entry, end.owner)
        end.network.respond(entry, end.owner, end.network.deserialized(response))

    async def cancel(self, entry: SimulatedRequest | None, respond: Callable[[Any], object]) -> None:
        if entry is not None:
            self.end.network.observer.on_executed(entry, self.end.owner)
        about = MANY if entry is None else entry.request
        found = [goal for name, goal in self._goals.items() if about in (MANY, name)]
        cancelled = [goal for goal in found if goal.is_active and await self.answer.cancels(goal)]
        for goal in cancelled:
            goal.is_cancel_requested = True
        code = 0 if cancelled else REJECTED if found or about == MANY else UNKNOWN_GOAL
        respond(SimpleNamespace(return_code=code, goals_canceling=[goal.goal_id for goal in cancelled]))

    def give_cancelled(self, entry: SimulatedRequest, response: Any, added: bytes | None) -> bool:
        network = self.end.network
        if added is not None and (more := network.deserialized(added).goals_canceling):
            response = SimpleNamespace(return_code=0, goals_canceling=[*response.goals_canceling, *more])
        network.respond(entry, self.end.owner, response)
        return bool(response.return_code != UNKNOWN_GOAL)

    def is_cancelled(self, response: Any) -> bool:
        return bool(response.status == CANCELED)

    def serialized(self, response: Any) -> bytes:
        return self.end.network.serialized(response)

    def _leave(self) -> None:
        self.end.network.servers.remove(self)
        self._requests.left()
        self._gone()


class SimulatedClient:
    """Implements :class:`midstride.node.component_host.CalledService`."""

    def __init__(self, end: ServiceEnd) -> None:
        self.end = end
        self._waiting: dict[SimulatedFuture, SimulatedRequest] = {}
        end.network.clients.append(end)

    def call(self, request: Any, feedback: Callable[[Any], object] | None = None) -> SimulatedFuture:
        return self._send("request", copied(request)).future

    def _send(self, kind: RequestKind, request: Any) -> SimulatedRequest:
        sent = self.end.network.send(self.end, kind, request)
        self._note(sent.future, sent)
        return sent

    def _note(self, future: SimulatedFuture, sent: SimulatedRequest) -> None:
        """Whatever has ``future`` waits for a response to ``sent``."""
        self._waiting[future] = sent
        future.add_done_callback(lambda future: self._waiting.pop(future, None))

    def unsent(self) -> SimulatedFuture:
        return SimulatedFuture(self.end.owner)

    def abandon(self, future: SimulatedFuture, error: Exception) -> None:
        if (sent := self._waiting.get(future)) is not None:
            self.end.network.give_up(sent)
        if not future.done():
            future.set_exception(error)

    def matched(self) -> int:
        network = self.end.network
        return int(network.serves_outside(self.end) or bool(network.found(self.end)))

    def publisher_ids(self) -> None:
        return None

    def destroy(self) -> None:
        if self.end in self.end.network.clients:
            self.end.network.clients.remove(self.end)


class SimulatedActionClient(SimulatedClient):
    """A client of a ROS action. ``accepted`` is called with the handle of each accepted goal."""

    def __init__(self, end: ServiceEnd, accepted: Callable[[Any], None]) -> None:
        super().__init__(end)
        self._accepted = accepted

    def call(self, request: Any, feedback: Callable[[Any], object] | None = None) -> SimulatedFuture:
        given = self.unsent()
        sent = self._send("goal", SimpleNamespace(goal=copied(request), feedback=feedback))
        self._note(given, sent)
        hand_on(
            sent.future, given, lambda each: SimulatedGoalHandle(self, sent.identity, each.accepted), self._accepted
        )
        return given

    def ask(self, kind: RequestKind, goal: str) -> SimulatedFuture:
        """Ask for the result of a goal, or for it to be cancelled."""
        return self._send(kind, goal).future


class SimulatedGoalHandle:
    """A goal as its client has it, as rclpy's handle."""

    def __init__(self, client: SimulatedActionClient, goal_id: str, accepted: bool) -> None:
        self.goal_id = goal_id
        self.accepted = accepted
        self._client = client
        # A port replaces it, so that it ends with the server.
        self.get_result_async: Callable[[], SimulatedFuture] = partial(client.ask, "result", goal_id)

    def cancel_goal_async(self) -> SimulatedFuture:
        return self._client.ask("cancel", self.goal_id)
