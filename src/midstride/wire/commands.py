"""The commands of the control plane, each with its reply.

Times are integers of nanoseconds on the ROS clock unless stated otherwise; durations are seconds. Each attached output
has a *gate*: while it is closed, what the component writes is counted and type-checked, and not published.

A *reading* command changes nothing and needs no revision. A *changing* one names the revision that its sender expects
the component to be at; the component refuses it at any other. A command between the two components of a hand-over is
neither: the manager may be gone by then; nor is the one that fences a component whose user code does not return.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Final, Generic, Literal, TypeAlias, TypeVar, get_args

import msgspec

from midstride.wire.program import Program
from midstride.wire.replies import (
    Answers,
    Attached,
    Claimed,
    Confirmed,
    CountedWrites,
    CutClock,
    CutResult,
    Detached,
    Discovered,
    Done,
    ExportedState,
    FencedOutputs,
    FetchedState,
    GatedWrites,
    Grid,
    Idle,
    LeaseKept,
    MissingRequests,
    PagePlace,
    PreviousModes,
    PreviousParameters,
    RateVerdict,
    RecordingSwitched,
    Records,
    ServedRequest,
    SharedSlotPlace,
    StateOffer,
    Yielded,
)
from midstride.wire.state import ComponentState, GateState, WireValue

R_co = TypeVar("R_co", covariant=True)

Seconds: TypeAlias = Annotated[float, msgspec.Meta(ge=0)]
CommandKind: TypeAlias = Literal["reading", "changing", "between"]
# How much longer the old side of a cut waits than the new one may write with its lease: enough for two steady clocks of
# which one is fast and the other slow by a tenth. A clock that is synchronised is slewed by less.
LEASE_SLACK: Final = 1.25


class Command(WireValue, Generic[R_co], frozen=True, kw_only=True, omit_defaults=True, tag_field="command"):
    """``timeout`` is how long the component may take (s); ``reply`` is the class of its reply."""

    kind: ClassVar[CommandKind] = "changing"
    reply: ClassVar[type[WireValue]]
    timeout: Seconds = 2.0

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        (cls.reply,) = get_args(cls.__orig_bases__[0])  # type: ignore[attr-defined]

    @property
    def name(self) -> str:
        return str(self.__struct_config__.tag)


class PingCommand(Command[Done], frozen=True, kw_only=True, tag="ping"):
    """Answer."""

    kind = "reading"


class ObserveCommand(Command[ComponentState], frozen=True, kw_only=True, tag="observe"):
    """The component's state.

    ``timeout``: how long the agent of a node without Midstride's API may look for what is not known of it yet; 0: it
    answers at once.
    """

    kind = "reading"


class ProgramCommand(Command[Program], frozen=True, kw_only=True, tag="program"):
    """The files of the component's program, as it has read them."""

    kind = "reading"


class GridCommand(Command[Grid], frozen=True, kw_only=True, tag="grid"):
    """The time grid of an output; with a topic, its readers there as well. Without a port: the clock of messages."""

    kind = "reading"
    port: str | None = None
    topic: str | None = None


class RecordsCommand(Command[Records], frozen=True, kw_only=True, tag="records"):
    """The command for the recording of an input."""

    kind = "reading"
    input: str


class ExportStateCommand(Command[ExportedState], frozen=True, kw_only=True, tag="export_state"):
    """The state of the component's user code, for its replacement."""

    kind = "reading"


class AwaitWriteCommand(Command[GatedWrites], frozen=True, kw_only=True, tag="await_write"):
    """Wait for a write behind the gate, and then until user code has returned from ``calls`` calls of its mode.

    For these it waits at most ``patience`` seconds.
    """

    kind = "reading"
    port: str
    topic: str
    calls: int = 1
    patience: Seconds = 0.0
    timeout: Seconds = 5.0


class AwaitRateCommand(Command[RateVerdict], frozen=True, kw_only=True, tag="await_rate"):
    """Wait until an output has kept ``rate`` (Hz) over ``window`` seconds of its clock, or ``until`` it has not.

    Messages behind the gate count as well. A ``rate`` of 0 is broken by an exception only.
    ``known_clock``: what cannot count on the clock of its node takes the rate as kept.
    """

    kind = "reading"
    port: str
    topic: str
    rate: float
    window: Seconds
    until: Literal["met", "broken"]
    timeout: Seconds = 5.0
    known_clock: bool = False


class AwaitMatchCommand(Command[Attached], frozen=True, kw_only=True, tag="await_match"):
    """Wait until the endpoint of an attachment is matched with ``peers`` compatible endpoints, as it sees it.

    With ``publisher_ids``, an input waits until its process has discovered those publishers instead, if the middleware
    tells that.
    """

    kind = "reading"
    port: str
    topic: str
    peers: int
    publisher_ids: list[str] = []
    timeout: Seconds = 5.0


class AwaitReadersCommand(Command[Attached], frozen=True, kw_only=True, tag="await_readers"):
    """Wait until an output behind its gate is matched with ``peers`` subscribers, and ready to publish to them.

    ``everyone`` is how many readers to wait for beyond that, and ``reader_ids`` which, at most ``patience`` seconds.
    """

    kind = "reading"
    port: str
    topic: str
    peers: int
    everyone: int = 0
    reader_ids: list[str] = []
    patience: Seconds = 0.0
    timeout: Seconds = 5.0


class CountWritesCommand(Command[CountedWrites], frozen=True, kw_only=True, tag="count_writes"):
    """Counts the messages that an output has written on a topic, published or held back.

    Where it is not attached, as after its hand-over: those it has written while it was attached to no topic.
    """

    kind = "reading"
    port: str
    topic: str


class AwaitIdleCommand(Command[Idle], frozen=True, kw_only=True, tag="await_idle"):
    """Wait until user code has returned, so that the data thread is free.

    ``leaving``: the functionalities that are to leave their modes, which an async call begun on entry prevents, too.
    """

    kind = "reading"
    leaving: list[str] = []


class DiscoverCommand(Command[Discovered], frozen=True, kw_only=True, tag="discover"):
    """Wait until the component's own middleware shows a publisher on ``topic``."""

    kind = "reading"
    topic: str


class AwaitCutCommand(Command[CutResult], frozen=True, kw_only=True, tag="await_cut"):
    """Wait until the cut is over on this side."""

    kind = "reading"
    cut: str
    timeout: Seconds = 5.0


class WelcomeCommand(Command[ComponentState], frozen=True, kw_only=True, tag="welcome"):
    """The manager has accepted the registration; the component stops waiting for one."""

    manager: str


class AttachCommand(Command[Attached], frozen=True, kw_only=True, tag="attach"):
    """Create the endpoint and wait until ``peers`` compatible endpoints are matched; only then open the gate.

    An input relies on ``rate`` (Hz), and ``tolerates`` so many missed messages; None: what its code states.
    ``condition``: its last message decides whether what it assumes holds. ``await_ready``: whether to wait until an
    input is ready, too; if not, the manager does before what relies on it.
    """

    port: str
    topic: str
    gate: GateState = "open"
    peers: int = 0
    timeout: Seconds = 5.0
    rate: float | None = None
    tolerates: int | None = None
    condition: bool = False
    await_ready: bool = True


class DetachCommand(Command[Detached], frozen=True, kw_only=True, tag="detach"):
    """Close the gate, wait for acknowledgements, destroy the endpoint."""

    port: str
    topic: str


class ModesCommand(Command[PreviousModes], frozen=True, kw_only=True, tag="modes"):
    """Change modes between two calls of user code; refused, and withdrawn, if a call does not return in time."""

    modes: dict[str, str]
    because: str = "the manager requested it"


class HoldCommand(Command[Done], frozen=True, kw_only=True, tag="hold"):
    """Begin no call of these functionalities until their modes change, for ``seconds`` at most; 0 ends that.

    Done as soon as no call of them is under way; refused, and withdrawn, if one does not return in time.
    """

    functionalities: list[str]
    seconds: Seconds


class SetParametersCommand(Command[PreviousParameters], frozen=True, kw_only=True, tag="set"):
    """Set changeable parameters, all of them or none.

    ``declared``: the values with which it counts as started from now on, by default those of ``parameters``. A
    parameter that has another one counts as set while the component ran. ``unknown_origin``: those of ``parameters``
    that a ROS tool had set on the predecessor, or that node itself.
    """

    parameters: dict[str, Any]
    declared: dict[str, Any] | None = None
    unknown_origin: list[str] = []


class ImportStateCommand(Command[Done], frozen=True, kw_only=True, tag="import_state"):
    """The state that the replaced component exported, with the UUID of its process (``exporter``), once for each.

    It is sent again where it is not known whether it was imported; where it was, the reply is the same.
    """

    state: bytes
    exporter: str = ""


class RecordCommand(Command[RecordingSwitched], frozen=True, kw_only=True, tag="record"):
    """Keep every receipt of these inputs from now on, or only the last few."""

    inputs: list[str]
    on: bool


class MeetCommand(Command[Done], frozen=True, kw_only=True, tag="meet"):
    """Connect to the peer of a hand-over at its address, and ping it."""

    peer: str
    address: str
    timeout: Seconds = 5.0


class CutSwap(WireValue, frozen=True, kw_only=True):
    """One output of a cut. ``latch``: the new side writes its last gated message again at the cut."""

    port: str
    topic: str
    latch: bool = False


class StateTransfer(WireValue, frozen=True, kw_only=True):
    """State moves from the old component to the new one once the last of their ``cuts`` has passed.

    That is at ``at`` on ``clock``. ``changes``: a bulk has moved before, and only what has changed since follows. It
    may take ``timeout`` seconds. If it fails, the new side does not take over where the state is ``required``; else it
    continues with its own. ``new`` at ``address`` is the new side. ``order_only``: no state moves; the new side waits,
    for as long, until all that belongs before the cuts has been published.
    """

    id: str
    cuts: int
    at: int
    clock: CutClock = "ros"
    changes: bool = False
    required: bool = True
    timeout: Seconds = 2.0
    new: str = ""
    address: str = ""
    order_only: bool = False


class PrepareStateCommand(Command[StateOffer], frozen=True, kw_only=True, tag="prepare_state"):
    """The new side: ask the peer what it exports at the cut, or, with ``bulk``, import the whole of it now."""

    peer: str
    address: str
    bulk: bool = False


class MuteCommand(Command[Done], frozen=True, kw_only=True, tag="mute"):
    """Make no call for a slot or a message until state has moved to this component, or until it is to `answer`.

    Its predecessor, which has no output to cut, makes them meanwhile.
    """


class SharedSlotPort(WireValue, frozen=True, kw_only=True):
    """An output of the component that gets a shared slot; ``rate`` is what it guarantees (Hz)."""

    topic: str
    rate: float | None


class ShareSlotCommand(Command[SharedSlotPlace], frozen=True, kw_only=True, tag="share_slot"):
    """To a side with a gate: give its peer, which uses Midstride's API, a shared slot for their cut.

    ``old``: the peer is the old side, so it gets the baton with its slot.
    """

    cut: str
    peer: str
    ports: list[SharedSlotPort]
    old: bool


class CutOutCommand(Command[Done], frozen=True, kw_only=True, tag="cut_out"):
    """The old side: write up to ``at``, then close the gates.

    It writes again if the new side has not reported its first write within ``resume_after`` seconds after ``at``; where
    messages drive the output, after the first input newer than ``at``. Both are on ``clock``. Without ``swaps``, only
    ``state`` moves, and this side makes no call any more. With a ``shared_slot``, the baton decides instead of ``at``.
    With a ``lease`` (s), no lock decides which side writes after ``at``: the new one asks for the right, and reaches
    this side at ``own_address``, if not where it listens.
    """

    cut: str
    swaps: list[CutSwap]
    at: int
    resume_after: Seconds
    clock: CutClock = "ros"
    state: StateTransfer | None = None
    shared_slot: SharedSlotPlace | None = None
    lease: Seconds = 0.0
    own_address: str = ""


class CutInCommand(Command[Done], frozen=True, kw_only=True, tag="cut_in"):
    """The new side: open the gates at ``at``, and report the first write to the peer.

    A rate-driven mode continues the grid through ``epoch``. With a ``shared_slot``, the baton decides instead of
    ``at``, and the offer of it ends some time after ``resume_after``. ``quiet``: it takes over without a message too.
    ``leased``: it writes only with a lease from its peer, which is on another host. ``shift``: by how much ``at`` is
    later than the moment that the peer was sent, which is on the clock of its host (ns).
    """

    cut: str
    swaps: list[CutSwap]
    at: int
    peer: str
    address: str
    epoch: int | None = None
    clock: CutClock = "ros"
    state: StateTransfer | None = None
    shared_slot: SharedSlotPlace | None = None
    resume_after: Seconds = 0.0
    quiet: bool = False
    leased: bool = False
    shift: int = 0


class CancelCutCommand(Command[Done], frozen=True, kw_only=True, tag="cancel_cut"):
    """The old side's gates stay or become open, the new side's closed.

    ``freed``, to an old side: the new one never writes again, as it has been cancelled, or its process has ended.
    """

    cut: str
    freed: bool = False


class ConfirmCutCommand(Command[Done], frozen=True, kw_only=True, tag="confirm_cut"):
    """To the new side of a cut with a lease: the old side never writes again, as its process has ended."""

    kind = "between"
    cut: str


class CutClaimCommand(Command[Claimed], frozen=True, kw_only=True, tag="claim"):
    """From the new side of a cut with a lease to the old one: may I write what belongs after its moment?"""

    kind = "between"
    cut: str


class GateCommand(Command[Done], frozen=True, kw_only=True, tag="gate"):
    """Open or close the gate of an attachment. With ``latch``, the last message it held back is published first."""

    port: str
    topic: str
    gate: GateState
    latch: bool = False


class FenceCommand(Command[FencedOutputs], frozen=True, kw_only=True, tag="fence"):
    """Let nothing more pass on these attachments (port, topic), whatever user code is doing; or ``lift`` that.

    It is carried out at once, on the control thread, at any revision: other commands may be waiting for the data
    thread. Refused where a message is just being published, and that does not end in time.
    """

    kind = "between"
    attachments: list[tuple[str, str]]
    lift: bool = False
    timeout: Seconds = 0.3


class KeepLeaseCommand(Command[LeaseKept], frozen=True, kw_only=True, tag="keep_lease"):
    """Let what is written on any output pass for ``seconds`` from ``seen`` on, and nothing after that; None: for good.

    ``seen``: a moment on the component's steady clock (ns) that it has answered such a command with. Without one,
    nothing changes but that it answers. Carried out as a fence is.
    """

    kind = "between"
    seconds: Seconds | None
    seen: int | None = None


class AnswerCommand(Command[Answers], frozen=True, kw_only=True, tag="answer"):
    """Answer the requests to the node's services from now on, instead of ``peer``, which is asked to stop first.

    Without an ``address``, no other instance answers. Done already if the component answers them. A ``peer`` without
    Midstride's API has ``drain`` (s) to answer the requests that it has taken. ``own_address``: where a peer on another
    host reaches this component.
    """

    peer: str = ""
    drain: Seconds = 2.0
    address: str | None = None
    own_address: str = ""


class JoinRequestsCommand(Command[Done], frozen=True, kw_only=True, tag="join_requests"):
    """Share the requests to the services with a successor that has no API, at ``place``: it is to answer."""

    place: PagePlace


class ReleaseCommand(Command[Done], frozen=True, kw_only=True, tag="release"):
    """A component started by hand leaves the system: last modes, no attachments, waiting for a manager."""


class StopCommand(Command[Done], frozen=True, kw_only=True, tag="stop"):
    """End the process in order."""


class CutTakenCommand(Command[Confirmed], frozen=True, kw_only=True, tag="taken"):
    """From the new side of a cut to the old one: it has written, or it has ``failed`` and will not.

    ``lock``: where the lock is that it has taken (:class:`midstride.wire.transport.CutLock`).
    """

    kind = "between"
    cut: str
    failed: bool = False
    lock: str = ""


class YieldCommand(Command[Yielded], frozen=True, kw_only=True, tag="yield"):
    """From the instance that is to answer requests to the one that does: stop, and say which you have handled.

    ``address`` is that of the ``instance`` that asks: what it does not receive is passed on to it.
    """

    kind = "between"
    address: str
    instance: str = ""


class MissingRequestsCommand(Command[MissingRequests], frozen=True, kw_only=True, tag="missing_requests"):
    """From an instance that no longer answers requests to the one that does: which of these have you not received?"""

    kind = "between"
    requests: list[str]


class ServeCommand(Command[ServedRequest], frozen=True, kw_only=True, tag="serve"):
    """From an instance that no longer answers requests to the one that does: handle this one, which only I received.

    ``data`` is the request as the middleware serializes it.
    """

    kind = "between"
    request: str
    service: str
    data: bytes


class CancelledGoalsCommand(Command[Done], frozen=True, kw_only=True, tag="cancelled_goals"):
    """From an instance that no longer answers requests to the one that does: for ``request`` I have cancelled goals.

    ``response`` is what I would have responded, as the middleware serializes it.
    """

    kind = "between"
    request: str
    response: bytes


class KeepResultsCommand(Command[Done], frozen=True, kw_only=True, tag="keep_results"):
    """From an instance that ends to the one that answers requests: all my goals have ended.

    ``results``: by goal, the response with the result, serialized, of those whose result no client has fetched.
    ``handled``: the requests about the goals that I have handled, each with when it came.
    """

    kind = "between"
    results: dict[str, bytes]
    handled: list[str] = []


class ResolveCutsCommand(Command[Done], frozen=True, kw_only=True, tag="resolve_cuts"):
    """From the next manager: leave no cut of an earlier one under way of which this is the ``new`` side, or the old.

    A cut at which the new side has taken over is waited for, any other is cancelled. New sides come before old ones.
    """

    kind = "between"
    new: bool
    timeout: Seconds = 2.0


class OfferStateCommand(Command[StateOffer], frozen=True, kw_only=True, tag="offer_state"):
    """From the new side to the old one, before the cut. ``changes``: it can import changes."""

    kind = "between"
    changes: bool


class FetchStateCommand(Command[FetchedState], frozen=True, kw_only=True, tag="fetch_state"):
    """From the new side to the old one: wait for the state after the last write."""

    kind = "between"
    transfer: str


class ImportingCommand(Command[Confirmed], frozen=True, kw_only=True, tag="importing"):
    """From the new side to the old one: it is importing the state, or has ``done`` so and is about to write."""

    kind = "between"
    transfer: str
    done: bool = False


# Every command by its name on the wire.
COMMANDS: Final[dict[str, type[Command[Any]]]] = {
    str(command.__struct_config__.tag): command for command in Command.__subclasses__()
}
