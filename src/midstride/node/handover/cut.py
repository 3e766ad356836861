"""The two sides of a cut: which write passes which gate, and when a side has finished.

docs/protocols/cut.md. Both publishers know one moment T. A write belongs to the
slot of the time grid whose call made it, or to the newest message that it answers, or else to the moment it is made.
The old side passes what belongs before T (of messages: up to T), the new side the rest. So neither clocks nor
scheduling decide, and every write passes exactly one gate. A call so late that it accounts for several slots belongs
to the first of them on the old side and to the last on the new one, so that T is written, if late. The new side locks
the cut before its first write, and the old one before it writes again: only one of them can. This module runs on the
data thread; :mod:`midstride.node.handover.cut_protocol` runs on the control thread.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from midstride.node.author.ports import GatePolicy, OutputLink, OutputOwner
from midstride.node.component_host import Host
from midstride.node.data.trigger import InfoSet
from midstride.node.handover.arbiter import Arbiter
from midstride.wire.replies import CutClock, LastWrite
from midstride.wire.state import GateState

# How long after T a message published before it may still be in transit (s).
GRACE: Final = 0.05
# How often at least, between two messages, the data thread finds that none has come before that counts as silence: a
# thread that has been kept from running has messages waiting.
LOOKS: Final = 3
# How many messages of an output without a rate the old side keeps for the case that it writes again; then the newest.
HELD: Final = 1000

Written = tuple[int, int]  # the publisher's number, and when


def belongs_after(
    runner: OutputOwner, at: int, host: Host, slot: int = 0, clock: CutClock = "ros", shift: int = 0
) -> bool:
    """Return whether the writes of ``runner`` now belong to the new side of a cut at ``at`` on ``clock``; ``slot`` and
    ``shift`` as below.
    """
    return call_belongs_after(runner, runner.slots, runner.info, at, host, slot, clock, shift)


def call_belongs_after(
    runner: OutputOwner,
    slots: tuple[int, int] | None,
    info: Any,
    at: int,
    host: Host,
    slot: int,
    clock: CutClock = "ros",
    shift: int = 0,
) -> bool:
    """True if a call for ``slots``, or for the message of ``info``, belongs after the cut ``at``.

    ``slot``: which of the slots that a call accounts for counts, 0 for the first and 1 for the last. Where ``/clock``
    drives the ROS clock, slots are not on the clock of messages; then the moment of the write decides. ``shift``: by
    how much ``at``, on the clock of this host, is later than on that of the other side's. A message has one time of
    publication for both, which is compared with the other side's.
    """
    if slots is not None and comparable(host, clock, "ros"):
        # Both sides round their grid to whole nanoseconds: a slot is T if it is nearest to it.
        rate = runner.rate
        return slots[slot] + (0 if rate is None else int(rate.period * 0.25e9)) >= at
    if info is not None and comparable(host, clock, "message"):
        return source_of(info, host) > at - shift
    return reading(host, clock) >= at


def reading(host: Host, clock: CutClock) -> int:
    return host.now() if clock == "ros" else host.message_now()


def comparable(host: Host, clock: CutClock, other: CutClock) -> bool:
    """Return whether the times of both clocks are of one."""
    return clock == other or not host.simulated_time or host.publishes_ros_time


def source_of(info: Any, host: Host) -> int:
    """The publication time of the message that a call answers, else its stamp, else now; of a set, the newest."""
    if isinstance(info, InfoSet):
        return max(source_of(one, host) for one in info)
    facts = host.read_info(info)
    source = facts.stamp if facts.source is None else facts.source
    return host.message_now() if source is None else source


@dataclass(eq=False)
class CutSide(GatePolicy):
    """One side of a cut. No moment is agreed: its arbiter alone decides, write by write, what passes."""

    links: Sequence[OutputLink]
    host: Host
    arbiter: Arbiter
    at: int = 0
    clock: CutClock = field(default="message", kw_only=True)
    written: dict[OutputLink, Written] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        self._runners = list(dict.fromkeys(link.output.owner for link in self.links))

    def now(self) -> int:
        """The clock of ``at``, which has come where none is agreed."""
        return self.at

    @property
    def driven_by_messages(self) -> bool:
        """Return whether a side on a moment of the clock may have nothing to write yet."""
        return False

    def arm(self) -> None:
        for link in self.links:
            link.enter(self)

    def passes(self, link: OutputLink) -> bool:
        return self.arbiter.admits()

    def admits(self, link: OutputLink) -> bool:
        return self.passes(link)

    def publish(self, link: OutputLink, message: Any) -> bool:
        return self._write(link, message)

    def _write(self, link: OutputLink, message: Any) -> bool:
        if not self.arbiter.begin(self.links.index(link)):
            return False
        try:
            link.publish(message)
        finally:
            self.arbiter.end()
        link.count += 1
        self.wrote(link)
        return True

    def wrote(self, link: OutputLink) -> None:
        self.written[link] = (link.count, self.host.now())

    def _set_gates(self, open_: bool) -> None:
        """Final for this cut. A link that another command has taken out of it, or destroyed, is left alone."""
        for link in self.links:
            if link.cut is self:
                link.set_gate(open_, self)


@dataclass(eq=False)
class _Agreed(CutSide):
    """Both sides know the moment ``at``: what belongs to the other one does not come before the arbiter."""

    clock: CutClock = field(default="ros", kw_only=True)
    # Of the new side, on another host (ns): see `call_belongs_after`.
    shift: int = field(default=0, kw_only=True)

    def now(self) -> int:
        return reading(self.host, self.clock)

    @property
    def driven_by_messages(self) -> bool:
        return any(runner.driven == "message" for runner in self._runners)

    def publish(self, link: OutputLink, message: Any) -> bool:
        return self.admits(link) and self._write(link, message)


@dataclass(eq=False)
class OutgoingSide(CutSide):
    """The old side."""

    over = True  # it need not be waited for
    # When the new side was known to have taken over (steady, ns).
    taken_at: int | None = field(default=None, init=False)
    # When the first message newer than T arrived (steady, ns): from then on a message-driven side should write.
    newer_at: int | None = field(default=None, init=False)
    # What was written after T, for the case that this side writes again.
    _held: dict[OutputLink, deque[Any]] = field(default_factory=dict, init=False)

    def shows(self, link: OutputLink) -> GateState:
        return "closed" if self.arbiter.passed_on else "open"

    def passed(self) -> bool:
        """Return whether everything that belongs before T has been written here. Then the gates close."""
        return self.over

    def finish(self) -> None:
        """Write nothing more, although T has not come: it had, and the clock was set back."""
        self.over = True
        self.confirmed()
        self._set_gates(False)

    def reopen(self) -> None:
        """Write again, first what was held back: the new side has not taken over in time, or the cut is cancelled."""
        self.over = True
        held = dict(self._held)
        self.confirmed()
        for link in self.links:
            if self._decides(link):
                link.set_gate(True, self)
                for message in held.get(link, ()):
                    link.gated -= 1
                    link.count += 1
                    link.publish(message)

    @property
    def closed(self) -> bool:
        """Return whether nothing but this cut keeps some attachment closed."""
        return any(map(self._decides, self.links))

    def _decides(self, link: OutputLink) -> bool:
        closed = link.set_by is self and not link.open
        return (closed or link.cut is self) and link in link.output.links

    def confirmed(self) -> None:
        """The new side has taken over, or this one has given up the cut: nothing needs to be held back."""
        for link, held in self._held.items():
            if link.held is held:
                link.held = None
        self._held.clear()

    def last(self) -> dict[str, LastWrite | None]:
        """Each output's last number, and when it was written, where that was since the cut was agreed."""
        found: dict[str, LastWrite | None] = {}
        for link in self.links:
            number, source = self.written.get(link, (link.count, None))
            found[str(link)] = LastWrite(number=number, source=source) if number else None
        return found


@dataclass(eq=False)
class OutgoingCut(_Agreed, OutgoingSide):
    """The old side, which writes what belongs before ``at``.

    ``in_order``: whether all messages that drive it come from one publisher, and so in order.
    """

    in_order: bool = False
    # From then on, what belongs before T is too late: the new side has waited for it no longer (ns, as T).
    until: int | None = None
    over = False
    # Since when its time grid seems to have stopped (steady, ns).
    _stopped_at: int | None = field(default=None, init=False)
    # How often it was looked whether everything has been written, since the last input.
    _looks: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._last_input = self.host.steady()

    def arm(self) -> None:
        super().arm()
        for link in self.links:
            # One late call accounts for all slots that have come, as elsewhere; each message is answered.
            link.held = self._held[link] = deque(maxlen=1 if link.output.owner.rate is not None else HELD)
        for runner in self._runners:
            runner.watch = self._on_input

    def passes(self, link: OutputLink) -> bool:
        runner = link.output.owner
        return not (belongs_after(runner, self.at, self.host, clock=self.clock) or self._outdated(runner))

    def _outdated(self, runner: OutputOwner) -> bool:
        """Return whether a call comes so late that its message must not be heard beside the new side's."""
        if self.until is not None and self.now() > self.until:
            return True
        rate = runner.rate
        if rate is None or self.now() - self.at <= max(GRACE, 2 * rate.period) * 1e9:
            return False
        if self.host.simulated_time:  # a call may be late by as much, however fast its clock runs
            return self.taken_at is not None and self.host.steady() - self.taken_at >= GRACE * 1e9
        # A process that was kept from running may come to this call before the report of the new side.
        return self.taken_at is not None or self.arbiter.is_overtaken

    def passed(self) -> bool:
        self._looks += 1
        if not self.over and all(self._runner_passed(runner) for runner in self._runners):
            self.over = self.now() >= self.at
            if self.over:
                self._set_gates(False)
        return self.over

    def confirmed(self) -> None:
        super().confirmed()
        for runner in self._runners:
            if runner.watch == self._on_input:
                runner.watch = None

    def _on_input(self, info: Any) -> None:
        self._last_input, self._looks = self.host.steady(), 0
        time = source_of(info, self.host) if comparable(self.host, self.clock, "message") else self.now()
        if self.newer_at is None and time > self.at:
            self.newer_at = self._last_input

    def _runner_passed(self, runner: OutputOwner) -> bool:
        if runner.busy is not None and not belongs_after(runner, self.at, self.host, clock=self.clock):
            return False  # an async call from before T may still write
        late = self.now() - self.at
        if runner.driven == "message":
            # A newer message on one input says nothing about other inputs and publishers: what they published before
            # T may still be in transit.
            if self.in_order and self.newer_at is not None:
                return True
            quiet = self.host.steady() - self._last_input > GRACE * 1e9 and self._looks >= LOOKS
            return late > GRACE * 1e9 and (self.newer_at is not None or quiet)
        rate = runner.rate
        if rate is None:
            return late >= 0
        tolerance = int(rate.period * 0.25e9)
        reached = (
            rate.slot is not None and comparable(self.host, self.clock, "ros") and rate.slot + tolerance >= self.at
        )
        stopped = late > max(GRACE, 2 * rate.period) * 1e9  # a grid that has stopped writes nothing
        if stopped and self.host.simulated_time:  # a call may be late by as much, however fast its clock runs
            if self._stopped_at is None:
                self._stopped_at = self.host.steady()
            stopped = self.host.steady() - self._stopped_at > GRACE * 1e9
        return reached or stopped


@dataclass(eq=False)
class IncomingSide(CutSide):
    """The new side. ``written`` holds each link's first write.

    ``latches``: the links whose messages were written once, behind the gate; what is kept is written again at the cut.
    """

    latches: Sequence[OutputLink] = ()
    # Whether it takes over although nothing is written; and whether it has.
    quiet: bool = field(default=False, kw_only=True)
    taken: bool = field(default=False, init=False)
    grace = 0.0  # how long after its first write messages may come that are not its own (s)

    @property
    def refused(self) -> bool:
        """Return whether the old side keeps the right to write."""
        return self.arbiter.refused

    def shows(self, link: OutputLink) -> GateState:
        return "open" if self.written or self.taken else "closed"

    def may_latch(self) -> bool:
        return True

    def latch(self) -> None:
        """For late joiners, publish what is kept behind the gate of each output that has written nothing since T.

        A quiet side that has none takes over without a message.
        """
        for link in self.latches:
            due = link.cut is self and link not in self.written and bool(link.kept)
            if due and self.may_latch():
                for message in link.kept:
                    self._write(link, message)
        if self.quiet and not self.written and not self.taken:
            self.taken = self._take()

    def _take(self) -> bool:
        """Return whether this side has the right to write, and keeps it."""
        if not self.arbiter.begin(0):
            return False
        self.arbiter.end()
        return True

    def conclude(self) -> None:
        self.latch()  # another output has written: that ended the cut before these were due
        self._set_gates(True)

    def close(self) -> None:
        """Write nothing more, and let the old side write: unless a later cut decides that for an output."""
        attached = [link for link in self.links if link in link.output.links]
        for link in attached:
            if link.cut in (None, self) and link.set_by in (None, self):
                link.set_gate(False, self)
        if not any(link.open or link.cut for link in attached):
            self.arbiter.give_back()

    def abandon(self) -> bool:
        """Close, unless it has written, or taken over without a message; whether it is closed."""
        if not self.written and not self.taken:
            self.close()
        return not self.written and not self.taken

    def first(self) -> dict[str, LastWrite | None]:
        found: dict[str, LastWrite | None] = dict.fromkeys(map(str, self.links))
        for link, (number, source) in self.written.items():
            found[str(link)] = LastWrite(number=number, source=source)
        return found

    def wrote(self, link: OutputLink) -> None:
        self.written.setdefault(link, (link.count, self.host.now()))


@dataclass(eq=False)
class IncomingCut(_Agreed, IncomingSide):
    """The new side, which writes what belongs to ``at`` or later."""

    grace = GRACE

    def arm(self, epoch: int | None = None) -> None:
        super().arm()
        for runner in self._runners:
            if epoch is not None and runner.rate is not None:
                runner.rate.regrid(epoch)

    def passes(self, link: OutputLink) -> bool:
        return belongs_after(link.output.owner, self.at, self.host, slot=1, clock=self.clock, shift=self.shift)

    def admits(self, link: OutputLink) -> bool:
        return self.passes(link) and self.arbiter.admits()

    def may_latch(self) -> bool:
        return self.arbiter.admits()

    def _take(self) -> bool:
        return self.arbiter.admits()

    def shows(self, link: OutputLink) -> GateState:
        return "open" if link in self.written or self.taken else "closed"
