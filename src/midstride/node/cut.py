"""The two sides of an agreed cut: which write passes which gate, and when a side's part is over.

Semantics.md section 7, *the cut is agreed, not chased*. Both publishers are told one moment T. A
write belongs to the slot of the time grid whose call made it, or to the newest message it answers,
or else to the moment it is made; the old side passes what belongs before T (for messages: up to
T), the new side the rest. So neither clock nor scheduling decides, and no write passes both gates
or none. A call so late that it stands for several slots belongs to the first of them on the old
side, and to the last on the new one: T is written, if late. This module is the data side's part;
:mod:`midstride.node.cut_protocol` is the control side's.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from midstride.node.host import Host
from midstride.node.ports import GatePolicy, OutputLink, OutputOwner
from midstride.node.trigger import InfoSet
from midstride.wire.commands import LastWrite
from midstride.wire.state import GateState

# How long after T a message published before it may still be on its way (s).
GRACE: Final = 0.05

Written = tuple[int, int]  # the publisher's number, and when


def belongs_after(runner: OutputOwner | None, at: int, host: Host, slot: int = 0) -> bool:
    """Whether what ``runner`` writes at this moment belongs to the new side of a cut at ``at``.

    ``slot`` says which of the slots that a call stands for counts: 0 the first, 1 the last.
    """
    if runner is None:
        return host.now() >= at
    if runner.slots is not None:
        # Both sides round their grid to whole nanoseconds: a slot is T if it is nearest to it.
        rate = runner.rate
        return runner.slots[slot] + (0 if rate is None else int(rate.period * 0.25e9)) >= at
    if runner.info is not None:
        return source_of(runner.info, host) > at
    return host.now() >= at


def source_of(info: Any, host: Host) -> int:
    """When what a call answers was published, or else stamped: the newest of a set; now, where nobody tells."""
    if isinstance(info, InfoSet):
        return max(source_of(one, host) for one in info)
    told = host.read_info(info)
    source = told.stamp if told.source is None else told.source
    return host.now() if source is None else source


class _Side(GatePolicy):
    """What both sides share. ``passes`` and ``shows`` are each side's own."""

    def __init__(self, links: Sequence[OutputLink], at: int, host: Host) -> None:
        self.links = tuple(links)
        self.at = at
        self.written: dict[OutputLink, Written] = {}
        self._host = host

    def wrote(self, link: OutputLink) -> None:
        self.written[link] = (link.count, self._host.now())

    def _set_gates(self, open_: bool) -> None:
        """Final for this cut. A link that another command has taken out of it, or destroyed, is left alone."""
        for link in self.links:
            if link.cut is self:
                link.set_gate(open_)

    def attached(self) -> list[OutputLink]:
        return [link for link in self.links if link in link.output.links]


class OutgoingCut(_Side):
    """The old side."""

    def __init__(self, links: Sequence[OutputLink], at: int, host: Host) -> None:
        super().__init__(links, at, host)
        self.over = False
        # When the first message newer than T came (steady, ns); on a message-driven side silence begins there.
        self.newer_at: int | None = None
        self._last_input = host.steady()
        self._runners = list(dict.fromkeys(link.output.owner for link in self.links if link.output.owner))

    def arm(self) -> None:
        for link in self.links:
            link.open = False
            link.cut = self
        for runner in self._runners:
            runner.watch = self._saw

    @property
    def driven_by_messages(self) -> bool:
        return any(runner.driven == "message" for runner in self._runners)

    def passes(self, link: OutputLink) -> bool:
        return not belongs_after(link.output.owner, self.at, self._host)

    def shows(self, link: OutputLink) -> GateState:
        return "open"

    def passed(self) -> bool:
        """Whether T has passed here: nothing that belongs before it will be written any more. Then the gates close."""
        if not self.over and all(self._runner_passed(runner) for runner in self._runners):
            self.over = self._host.now() >= self.at
            if self.over:
                self._set_gates(False)
        return self.over

    def reopen(self) -> None:
        """The old side writes again: it was never relieved, or the cut is cancelled."""
        self.over = True
        self._unwatch()
        for link in self.attached():
            link.set_gate(True)

    def relieved(self) -> None:
        self._unwatch()

    def last(self) -> dict[str, LastWrite | None]:
        """Each output's last number, and when it was written, where that was since the cut was agreed."""
        found: dict[str, LastWrite | None] = {}
        for link in self.links:
            number, source = self.written.get(link, (link.count, None))
            found[str(link)] = LastWrite(number=number, source=source) if number else None
        return found

    def _unwatch(self) -> None:
        for runner in self._runners:
            if runner.watch == self._saw:
                runner.watch = None

    def _saw(self, info: Any) -> None:
        self._last_input = self._host.steady()
        if self.newer_at is None and source_of(info, self._host) > self.at:
            self.newer_at = self._last_input

    def _runner_passed(self, runner: OutputOwner) -> bool:
        if runner.busy is not None and not belongs_after(runner, self.at, self._host):
            return False  # an async call from before T has still to write
        late = self._host.now() - self.at
        if runner.driven == "message":
            # Something newer on one input says nothing of another input, or of another publisher: what they
            # published before T may still be on its way.
            quiet = self._host.steady() - self._last_input
            return late > GRACE * 1e9 and (self.newer_at is not None or quiet > GRACE * 1e9)
        rate = runner.rate
        if rate is None:
            return late >= 0
        tolerance = int(rate.period * 0.25e9)
        reached = rate.slot is not None and rate.slot + tolerance >= self.at
        return reached or late > max(GRACE, 2 * rate.period) * 1e9  # a grid that stands still writes nothing


class IncomingCut(_Side):
    """The new side. ``written`` holds each link's first write."""

    def __init__(self, links: Sequence[OutputLink], at: int, host: Host, latches: Sequence[OutputLink]) -> None:
        super().__init__(links, at, host)
        self._latches = tuple(latches)

    def arm(self, epoch: int | None) -> None:
        runners = list(dict.fromkeys(link.output.owner for link in self.links if link.output.owner))
        for link in self.links:
            link.cut = self
        for runner in runners:
            if epoch is not None and runner.rate is not None:
                runner.rate.regrid(epoch)

    def passes(self, link: OutputLink) -> bool:
        return belongs_after(link.output.owner, self.at, self._host, slot=1)

    def shows(self, link: OutputLink) -> GateState:
        return "open" if link in self.written else "closed"

    def latch(self) -> None:
        """Write the last gated message again where nothing has been written since T, so that late joiners get it."""
        for link in self._latches:
            if link.cut is self and link not in self.written and link.write_held():
                self.wrote(link)

    def conclude(self) -> None:
        self._set_gates(True)

    def close(self) -> None:
        for link in self.attached():
            link.set_gate(False)

    def first(self) -> dict[str, LastWrite | None]:
        found: dict[str, LastWrite | None] = dict.fromkeys(map(str, self.links))
        for link, (number, source) in self.written.items():
            found[str(link)] = LastWrite(number=number, source=source)
        return found

    def wrote(self, link: OutputLink) -> None:
        self.written.setdefault(link, (link.count, self._host.now()))
