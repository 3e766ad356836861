"""What a component's process is given by its back end: the only way ``node`` reaches ROS.

Two sides, two threads (platform.md): the *data* side runs user code and owns the endpoints; the
*control* side is an asyncio loop that runs the agent and never user code. Whatever touches
endpoints or modes goes through :meth:`Host.on_data` and so falls between two calls of user code.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from midstride.model.contract import QoS
from midstride.wire.state import ComponentState, Endpoint
from midstride.wire.transport import Transport

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class MessageInfo:
    """What the middleware tells of a received message; None where it cannot tell.

    ``source`` is the time of publication (ns), ``number`` the publisher's own count,
    ``publisher`` an opaque identity of the publishing endpoint. ``stamp`` is a time that every receiver of the
    message reads alike (its header's), where the time of publication is not told: good enough to agree on a cut.
    """

    source: int | None
    number: int | None
    publisher: str | None
    stamp: int | None = None


class Publisher(Protocol):
    """An endpoint of an output on one topic. Used on the data side only, save what says otherwise."""

    def publish(self, message: Any) -> None: ...

    def matched(self) -> int:
        """How many *compatible* subscriptions are matched; -1 before the platform knows of it. On the control side."""
        ...

    async def acknowledged(self, timeout: float) -> bool | None:
        """Whether every matched reliable reader has all; None where that cannot be known.

        Awaited on the control side; neither side stands still meanwhile.
        """
        ...

    def destroy(self) -> None: ...


class Subscription(Protocol):
    """An endpoint of an input on one topic."""

    def matched(self) -> int:
        """How many compatible publishers are matched; -1 before the platform knows of it. On the control side."""
        ...

    def destroy(self) -> None: ...


class Timer(Protocol):
    """Calls at ``epoch + n * period`` on the ROS clock; a late call skips slots, it does not burst.

    A late call is given the slot that came due first. Used on the data side.
    """

    def regrid(self, epoch: int) -> None:
        """Go on along the grid through ``epoch`` (ns), from its next slot after now."""
        ...

    def cancel(self) -> None: ...


class Host(Protocol):
    """One per process (in the simulator: one per component)."""

    backend: str
    instance: str
    # Where it listens for its manager; None where it belongs to no system.
    transport: Transport | None

    def now(self) -> int:
        """The ROS clock, ns; 0 while it is driven by ``/clock`` and none has come. On the data path: cheap."""
        ...

    def steady(self) -> int:
        """The steady clock, ns: time-outs, drains, heartbeats, times of receipt. On the data path: cheap."""
        ...

    @property
    def logger(self) -> Any: ...

    @property
    def ros_node(self) -> Any:
        """The ROS node of the data side, for the author's own ends; None in the simulator."""
        ...

    # -- data side -------------------------------------------------------------------------------

    def on_data(self, function: Callable[[], T]) -> Awaitable[T]:
        """Run ``function`` on the data side between two calls of user code; awaited on the control side.

        It is queued when ``on_data`` is called, in order, whether or not the result is awaited.
        """
        ...

    def run_coroutine(self, coroutine: Coroutine[Any, Any, None], done: Callable[[], None]) -> None:
        """Drive an async mode function on the data side; called, and ``done`` is called, on the data side.

        ``coroutine`` raises nothing: whoever hands it over has wrapped it.
        """
        ...

    def pause(self, seconds: float) -> Awaitable[None]:
        """Something to await inside such a coroutine: done after ``seconds`` on the ROS clock."""
        ...

    def create_publisher(self, topic: str, type_: type, qos: QoS) -> Publisher: ...

    def create_subscription(
        self, topic: str, type_: type, qos: QoS, callback: Callable[[Any, Any], None]
    ) -> Subscription:
        """``callback(message, info)``: ``info`` is whatever the middleware hands over, as it comes.

        So a message costs nothing that nobody asks for; :meth:`read_info` tells what it says.
        """
        ...

    def read_info(self, info: Any) -> MessageInfo: ...

    def create_timer(self, period: float, epoch: int | None, callback: Callable[[int, int], None]) -> Timer:
        """``callback(first, last)``: the nominal times (ns) of the slots that the call stands for.

        There is more than one where it comes late: it stands for those it has missed as well.
        ``epoch`` None: the first call comes at once.
        """
        ...

    # -- control side ----------------------------------------------------------------------------

    async def sleep(self, seconds: float) -> None:
        """On the steady clock."""
        ...

    def reachable(self) -> str:
        """Where a manager can find it, in words."""
        ...

    def publish_state(self, state: ComponentState) -> None:
        """Show the state to the platform's own tools, read only (ROS 2: parameters; ROS 1: a latched topic)."""
        ...

    def extra_endpoints(self) -> list[Endpoint]:
        """Endpoints of the ROS node that are neither ports nor ROS's own, after the author's set-up."""
        ...

    def parameter(self, name: str, default: Any, on_change: Callable[[Any], None] | None) -> Any:
        """Declare a parameter of the ROS node, on the data side, and return its value."""
        ...

    def set_parameters(self, values: dict[str, Any]) -> None:
        """Set declared parameters at once or not at all, on the data side. Raises CommandRefused with the reason.

        ``on_change`` may raise: then nothing is set, and what it raised is the reason.
        """
        ...

    def run(self, main: Callable[[], Awaitable[None]]) -> None:
        """Bring the process up, run ``main`` on the control thread, and return when it does.

        What ``main`` raises is raised here. The only place where signal handlers are set: SIGTERM and SIGINT cancel
        ``main``, which then ends in order.
        """
        ...


class HostFactory(Protocol):
    """Makes the host of a component; called in ``Component.start``."""

    def __call__(self, name: str, namespace: str) -> Host: ...
