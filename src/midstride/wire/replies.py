"""The replies of components to the commands of the control plane, which are in ``commands``.

Times are integers of nanoseconds on the ROS clock unless stated otherwise; durations are seconds. Each attached output
has a *gate*: while it is closed, what the component writes is counted and type-checked, and not published.
"""

from __future__ import annotations

from typing import Any, Literal, TypeAlias

import msgspec

from midstride.wire.state import WireValue

TriggerKind: TypeAlias = Literal["rate", "message", "none"]
CutOutcome: TypeAlias = Literal["waiting", "done", "resumed", "cancelled"]
# On which clock a cut is agreed: that of time grids, or that of messages' times of publication. They differ where
# ``/clock`` drives the ROS clock.
CutClock: TypeAlias = Literal["ros", "message"]
# A moment of the steady clock, and what the ROS clock then showed (ns).
ClockMoment: TypeAlias = tuple[int, int]


class Done(WireValue, frozen=True, kw_only=True):
    """Carried out; there is nothing to report."""


class PagePlace(WireValue, frozen=True, kw_only=True):
    """The part that a component gets in the page of the gates, which it shares with a node there.

    ``page`` and ``library`` are files; ``index`` is that of its part.
    """

    page: str
    library: str
    index: int


class Answers(WireValue, frozen=True, kw_only=True):
    """The component answers requests; the peer that did so before has not answered ``outlasting`` that it had taken.

    ``first``: it does not yet; the peer is to join there before, and the command is then sent again.
    """

    outlasting: int = 0
    first: PagePlace | None = None


class Grid(WireValue, frozen=True, kw_only=True):
    """The time grid of the mode that drives an output: slot n is at ``epoch + n * period``.

    ``now`` is on the clock on which a cut of that output is agreed: ``clock``, which gains ``speed`` seconds in each
    second. ``readers`` is the number of matched subscriptions on the topic asked about, and
    ``reader_ids`` identifies those that the process has discovered, where the middleware does.
    """

    trigger: TriggerKind
    now: int
    clock: CutClock = "ros"
    speed: float = 1.0
    epoch: int | None = None
    period: float | None = None
    readers: int | None = None
    reader_ids: list[str] = []


class Receipt(msgspec.Struct, frozen=True, array_like=True):
    """One received message: when (steady ns), and what the middleware reports about it, None where it does not."""

    received: int
    source: int | None
    number: int | None
    publisher: str | None


class Records(WireValue, frozen=True, kw_only=True):
    """The recording of an input. ``now`` is the steady clock (ns).

    ``moments``: how the ROS clock has moved meanwhile, where ``/clock`` drives it; else None. ``ros_sources``: times of
    publication are on that clock.
    """

    rows: list[Receipt]
    publisher_identity: bool
    now: int
    moments: list[ClockMoment] | None = None
    ros_sources: bool = False


class ExportedState(WireValue, frozen=True, kw_only=True):
    """``state`` is None where the component keeps none, or it is ``lost``, and why: it does not answer."""

    state: bytes | None
    lost: str | None = None


class FetchedState(WireValue, frozen=True, kw_only=True):
    """The state at a cut. ``handled``: by publisher, the time of the newest message that it includes (ns).

    That is for functionalities without an output in the cut. Of other publishers, it includes what was published until
    ``since``. ``requests``: those to the node's services that it includes; None where the old side did not answer them.
    ``goals``: as in :class:`Yielded`.
    """

    state: bytes | None
    handled: dict[str, int]
    since: int
    requests: list[str] | None = None
    goals: list[str] = []


class StateOffer(WireValue, frozen=True, kw_only=True):
    """The offer of a component to export state at a cut: of ``changes``, the bulk has to move before.

    ``order``: no state, but what it is to publish may still be waiting in it, and nothing newer may be published first.
    """

    exports: Literal["nothing", "order", "whole", "changes"]

    @property
    def has_state(self) -> bool:
        """Return whether state moves, and not only the order of messages."""
        return self.exports in ("whole", "changes")


class GatedWrites(WireValue, frozen=True, kw_only=True):
    """The number of messages written behind the gate; ``wrong_type``: what was wrong with the last refused one.

    ``failed``: user code has raised.
    """

    gated: int
    wrong_type: str | None
    failed: bool = False


class CountedWrites(WireValue, frozen=True, kw_only=True):
    """The number of messages that an output has written."""

    written: int


class RateVerdict(WireValue, frozen=True, kw_only=True):
    """``reached``: what was waited for has happened. ``rate`` (Hz) and the longest ``pause`` (s) of the last window.

    ``failed``: user code has raised.
    """

    reached: bool
    rate: float
    pause: float
    failed: bool = False


class LastWrite(WireValue, frozen=True, kw_only=True):
    """An output's last number, and when it was written (None: not since the cut was agreed)."""

    number: int
    source: int | None


class MovedState(WireValue, frozen=True, kw_only=True):
    """State of so many ``bytes`` has moved.

    ``silent``: for how long no message was published, from the last one of the old node to the first one of the new
    one, on the topic where that was longest (s); None where none was published, or none is handed over, and of a
    component, which only knows its own part. ``held``: for how long requests to the services of both were held (s).
    """

    bytes: int
    silent: float | None
    held: float


class CutResult(WireValue, frozen=True, kw_only=True):
    """The end of a cut on this side, by ``"port topic"``: ``last`` for the old side, ``first`` for the new side.

    Old side: *done* once it has passed the cut and the new side has written; of a lifecycle node, once it is inactive.
    *waiting*: not finished in time.
    ``because``: what was wrong with the transfer of state; ``moved``: what has moved; of two nodes without the API, the
    new side says it, else the old side.
    ``by_input``: both answer messages, and each message is answered by one of them. ``out_of_step``: it was begun so,
    and one of the two has done otherwise before it was over.
    """

    outcome: CutOutcome
    because: str | None = None
    moved: MovedState | None = None
    by_input: bool = False
    out_of_step: bool = False
    last: dict[str, LastWrite | None] = msgspec.field(default_factory=dict)
    first: dict[str, LastWrite | None] = msgspec.field(default_factory=dict)


class Attached(WireValue, frozen=True, kw_only=True):
    """``matched``: with how many compatible endpoints; ``ready_in``: how long it may yet lose messages (s).

    ``missing``: which of the publishers that were asked about the process has not discovered, None where the middleware
    does not tell.
    """

    matched: int
    ready_in: float = 0.0
    missing: list[str] | None = None


class Detached(WireValue, frozen=True, kw_only=True):
    """``acknowledged``: whether every reader has the last message, None where that is unknown; ``last``: its number."""

    acknowledged: bool | None
    last: int | None


class PreviousModes(WireValue, frozen=True, kw_only=True):
    """The modes before a change, by functionality. ``at``: when it happened (steady ns), where it ended a hold."""

    before: dict[str, str]
    at: int | None = None


class PreviousParameters(WireValue, frozen=True, kw_only=True):
    """The values before a change, by parameter.

    ``declared``: those of these parameters that had been set while the component ran, as in its state.
    """

    before: dict[str, Any]
    declared: dict[str, Any] = msgspec.field(default_factory=dict)


class RecordingSwitched(WireValue, frozen=True, kw_only=True):
    """The time at which recording started or stopped (steady ns)."""

    now: int


class Yielded(WireValue, frozen=True, kw_only=True):
    """The requests that the component has handled lately, each as every server of the service identifies it.

    ``goals``: those of ROS actions that it has accepted, by UUID, and answers for from now on, too. ``place``: it does
    not use Midstride's API, and answers until the successor has joined there, and takes over itself.
    """

    handled: list[str]
    goals: list[str] = []
    place: PagePlace | None = None


class MissingRequests(WireValue, frozen=True, kw_only=True):
    """The requests that have not arrived."""

    requests: list[str]


class ServedRequest(WireValue, frozen=True, kw_only=True):
    """The response to a request that was passed on, serialized; None where there is none to send: the request has
    arrived after all, or its code has raised."""

    response: bytes | None


class Idle(WireValue, frozen=True, kw_only=True):
    """``busy``: why user code had not returned in time, in words; None where the data thread is free."""

    busy: str | None


class Discovered(WireValue, frozen=True, kw_only=True):
    """The answer whether the middleware of the component shows the endpoint; None where it has no discovery that
    could stop.
    """

    found: bool | None


class FencedOutputs(WireValue, frozen=True, kw_only=True):
    """The number of the last message of each of these outputs, by ``"port topic"``."""

    last: dict[str, int]


class LeaseKept(WireValue, frozen=True, kw_only=True):
    """``now``: the moment of the answer, on the component's steady clock (ns)."""

    now: int


class SharedSlotPlace(PagePlace, frozen=True, kw_only=True):
    """The part that a component gets in the page of the gates for the length of a hand-over.

    ``other`` is the index of the other side, which has a gate. ``timed``: no output of the component has a rate.
    """

    baton: int
    other: int
    timed: bool


class Claimed(WireValue, frozen=True, kw_only=True):
    """May the new side of a cut write? With ``leased``, for so many ``seconds`` from its request on.

    ``yours``: for good. ``recalled``: what it has runs out. ``refused``: the old side writes.
    """

    how: Literal["leased", "yours", "recalled", "refused"]
    seconds: float = 0.0


class Confirmed(WireValue, frozen=True, kw_only=True):
    """``resumed``: it is too late, and the old side writes again."""

    resumed: bool
