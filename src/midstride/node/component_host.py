"""The interface of a back end to a component's process: the only way ``node`` reaches ROS.

There are two threads. The *data* thread runs user code and owns the endpoints. The *control* thread is an asyncio loop
that runs the agent and never user code. Whatever touches endpoints or modes goes through :meth:`Host.on_data`, and so
happens between two calls of user code.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Coroutine, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias, TypeVar

from midstride.model.contract import QoS
from midstride.node.clock_history import ClockHistory
from midstride.node.diagnostic_status import DiagnosticEntry
from midstride.node.request_admission import RequestAdmission
from midstride.wire.state import ComponentState, Endpoint
from midstride.wire.transport import Transport

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class MessageInfo:
    """The middleware's report of a received message; None where it has none.

    ``source`` is the time of publication (ns), ``number`` the publisher's own count,
    ``publisher`` an opaque identity of the publishing endpoint, the same in every process. ``stamp`` is the time in
    the message's header, which is the same for every receiver: where the time of publication is unknown, it is good
    enough to agree on a cut. ``writer`` is an identity that only this process has, where there is no other.
    """

    source: int | None
    number: int | None
    publisher: str | None
    stamp: int | None = None
    writer: str | None = None

    @property
    def distinct_writer(self) -> str | None:
        """An identity that tells the publishers of this process's messages apart, whether or not others have it."""
        return self.writer if self.publisher is None else self.publisher


class Publisher(Protocol):
    """An endpoint of an output on one topic. Used on the data thread only, except where stated."""

    def publish(self, message: Any) -> None: ...

    def matched(self) -> int:
        """The number of *compatible* subscriptions matched; -1 before the platform knows it. On the control thread."""

    def reader_ids(self) -> frozenset[str]:
        """The identities of the subscriptions that its process has discovered on the topic; empty where unknown.

        On the control thread.
        """

    async def acknowledged(self, timeout: float) -> bool | None:
        """Return whether every matched reliable reader has received everything; None where that is unknown.

        Awaited on the control thread; blocks neither thread.
        """

    def destroy(self) -> None: ...


class Subscription(Protocol):
    """An endpoint of an input on one topic."""

    def matched(self) -> int:
        """The number of compatible publishers matched; -1 before the platform knows it. On the control thread."""

    def publisher_ids(self) -> frozenset[str] | None:
        """The identities of the publishers that its process has discovered on the topic; None where unknown.

        On the control thread.
        """

    def destroy(self) -> None: ...


class ServedService(Protocol):
    """A service that a server answers. Used on the data thread."""

    def retire(self) -> None:
        """Answer the requests that have arrived, then leave the graph.

        While another instance of the role answers, it stays there until the process ends: it passes on what only it
        receives.
        """


class CalledService(Protocol):
    """A client's side of a service. Used on the data thread, except where stated."""

    def call(self, request: Any, feedback: Callable[[Any], object] | None = None) -> Any:
        """Send ``request``; the platform's future of the response. Of a ROS action, a goal and its handle."""

    def unsent(self) -> Any:
        """A future of the platform for what is sent later."""

    def abandon(self, future: Any, error: Exception) -> None:
        """Wait for this response no longer: the future ends with ``error``."""

    def matched(self) -> int:
        """1 where a server has been discovered, else 0. On either thread."""

    def publisher_ids(self) -> None:
        """A service has no publishers."""

    def destroy(self) -> None: ...


class GoalAnswers(Protocol):
    """The decisions of an action server about goals."""

    async def accepts(self, goal: Any) -> bool: ...

    async def cancels(self, goal: Any) -> bool: ...

    async def execute(self, goal: Any) -> Any: ...


class Timer(Protocol):
    """Calls at ``epoch + n * period`` on the ROS clock; a late call skips slots, it does not burst.

    A late call is given the slot that came due first. Used on the data thread.
    """

    def regrid(self, epoch: int) -> None:
        """Continue along the grid through ``epoch`` (ns), from its next slot after now."""

    def cancel(self) -> None: ...


class HeldParameter(Protocol):
    """A parameter that can be set from outside; ``declared`` is the value that it was started with.

    ``closed`` says why it cannot be set any more.
    """

    name: str
    declared: Any
    closed: str

    @property
    def value(self) -> Any: ...

    def fitted(self, value: Any) -> Any:
        """``value`` as a value of this parameter. Raises NodeError where it is of another type."""


class NodeParameters(Protocol):
    """The parameters of the ROS node. Used on the data thread, except where stated."""

    def declare(self, name: str, default: Any, on_change: Callable[[Any], None] | None) -> Any:
        """Declare a parameter, and return its value."""

    def set(self, values: dict[str, Any]) -> None:
        """Set declared parameters, all of them or none. Raises CommandRefused with the reason.

        ``on_change`` may raise: then nothing is set, and its error is the reason.
        """

    def held(self) -> Mapping[str, HeldParameter]:
        """The parameters of the node, by name, also those that are declared on the node itself. Any thread."""

    def on_changed(self, changed: Callable[[], object]) -> None:
        """Have ``changed`` called on the data thread when a parameter has been set from outside."""


class Host(Protocol):
    """One per process (in the simulator: one per component)."""

    instance: str
    # Where it listens for its manager, None where it belongs to no system; and the same in words, for a message.
    transport: Transport | None
    reachable: str
    # Whether a manager has welcomed the component, which says so here.
    managed: bool
    parameters: NodeParameters
    # Whether servers and clients of services can be ports.
    has_services: bool
    # Which requests the component answers; a platform whose instances have one node name has its services ask it.
    admission: RequestAdmission

    @property
    def node_name(self) -> str | None:
        """The full name of the ROS node, once it has joined; None where there is none."""

    def now(self) -> int:
        """The ROS clock, ns; 0 while nothing has arrived on a ``/clock`` that drives it. Cheap: on the data path."""

    @property
    def simulated_time(self) -> bool:
        """Return whether ``/clock`` drives the ROS clock."""

    # Whether messages' times of publication are on the ROS clock, also where `/clock` drives it.
    publishes_ros_time: bool

    def message_now(self) -> int:
        """The clock of messages' times of publication (:class:`MessageInfo`), ns."""

    @property
    def clock_history(self) -> ClockHistory:
        """The history of the ROS clock as ``/clock`` has driven it; empty where it does not."""

    def steady(self) -> int:
        """The steady clock, ns: for time-outs, heartbeats and times of receipt. Cheap: on the data path."""

    @property
    def logger(self) -> Any: ...

    @property
    def ros_node(self) -> Any:
        """The ROS node of the data thread, for the author's own use; None in the simulator."""

    # -- data thread -----------------------------------------------------------------------------

    def on_data(self, function: Callable[[], T]) -> Awaitable[T]:
        """Run ``function`` on the data thread between two calls of user code; awaited on the control thread.

        It is queued when ``on_data`` is called, in order, whether or not the result is awaited.
        """

    def run_coroutine(self, coroutine: Coroutine[Any, Any, None], done: Callable[[], None]) -> None:
        """Drive an async mode function. Called on the data thread, where ``done`` is called as well.

        ``coroutine`` must not raise.
        """

    def pause(self, seconds: float) -> Awaitable[None]:
        """Something to await inside such a coroutine: done after ``seconds`` on the ROS clock."""

    def create_publisher(self, topic: str, type_: type, qos: QoS) -> Publisher: ...

    def create_subscription(
        self, topic: str, type_: type, qos: QoS, callback: Callable[[Any, Any], None]
    ) -> Subscription:
        """``callback(message, info)``: ``info`` is what the middleware passes, unread.

        :meth:`read_info` reads it: a message costs nothing for what is not needed.
        """

    def read_info(self, info: Any) -> MessageInfo: ...

    def create_server(self, name: str, type_: type, answer: Callable[[Any, Any], Any]) -> ServedService:
        """``answer(request, response)`` returns the response, None for none, or an awaitable of these.

        It is called for what ``admission`` admits. Raises NodeError where there are no services.
        """

    def create_client(self, name: str, type_: type) -> CalledService:
        """Raises NodeError where there are no services."""

    def create_action_server(self, name: str, type_: type, answers: GoalAnswers) -> ServedService:
        """Raises NodeError where there are no ROS actions."""

    def create_action_client(self, name: str, type_: type, accepted: Callable[[Any], None]) -> CalledService:
        """``accepted`` is called with the handle of each accepted goal, before the future of it is done.

        Raises NodeError where there are no ROS actions.
        """

    def create_timer(self, period: float, epoch: int | None, callback: Callable[[int, int], None]) -> Timer:
        """``callback(first, last)``: the nominal times (ns) of the slots that the call accounts for.

        A late call accounts for the slots that were missed as well. ``epoch`` None: the first call comes at once.
        """

    # -- control thread --------------------------------------------------------------------------

    async def sleep(self, seconds: float) -> None:
        """On the steady clock."""

    def publish_state(self, state: ComponentState) -> None:
        """Show the state to the platform's own tools, read only (ROS 2: parameters; ROS 1: a latched topic)."""

    def publish_diagnostics(self, entries: Callable[[], Sequence[DiagnosticEntry]]) -> None:
        """Publish on ``/diagnostics``, where the platform has its message type.

        ``entries`` is called, in any thread, where something listens.
        """

    def discovers(self, topic: str) -> bool | None:
        """Return whether the middleware shows a publisher on ``topic``; None where it has no discovery that could
        stop.
        """

    def extra_endpoints(self) -> list[Endpoint]:
        """Endpoints of the ROS node that are neither ports nor ROS's own, after the author's set-up."""

    def run(self, main: Callable[[], Awaitable[None]]) -> None:
        """Join the platform, run ``main`` on the control thread, and return when it does.

        What ``main`` raises is raised here. Signal handlers are set here only: SIGTERM and SIGINT cancel
        ``main``, which then ends in order.
        """


# Makes the host of a component of this name and namespace; called in ``Component.start``.
HostFactory: TypeAlias = Callable[[str, str], Host]
