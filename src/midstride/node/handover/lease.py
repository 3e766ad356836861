"""The right to write after a cut between two hosts: it moves by messages, with a lease until the move is confirmed.

Two hosts share no lock, and a message may be late or lost. So the old side *gives* the new one the right for a while,
and neither writes after the cut unless it is sure that the other one does not: the new side while its lease lasts, the
old one once every lease that it has given is over. The first write is reported; the old side then never writes again by
itself, and its answer gives the right for good (docs/protocols/lease.md).

The lease is measured on the steady clock of each side, from the request at the new one, and from the answer at the old
one, which is later. So no clock of one host is compared with that of another.
"""

from __future__ import annotations

import threading
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Final, TypeVar

from midstride.errors import BackendError, CommandRefused, Unreachable
from midstride.node.component_host import Host
from midstride.wire.channel import Channel, result_of
from midstride.wire.commands import LEASE_SLACK, Command, CutClaimCommand, CutTakenCommand
from midstride.wire.frames import Reply
from midstride.wire.replies import Claimed

R = TypeVar("R")

# How often the new side asks for its lease (s), and how long it waits for each answer.
RENEWAL: Final = 0.2
ANSWER: Final = 0.25
# How often it says that it writes nothing any more, until the old side has heard that (s): first, and at the longest.
TELLING: Final = 0.25
TELLING_LONGEST: Final = 2.0


@dataclass(eq=False)
class _LeaseArbiter:
    """An arbiter without a lease (:class:`midstride.node.handover.arbiter.Arbiter`); each side says what differs."""

    steady: Callable[[], int]
    refused: bool = field(default=False, init=False)
    passed_on: bool = field(default=False, init=False)  # that is reported

    def begin(self, output: int) -> bool:
        return True

    def end(self) -> None: ...

    def admits(self) -> bool:
        return True

    def request(self) -> None: ...

    def renounce(self) -> bool:
        return True

    def give_back(self) -> None: ...

    @property
    def settled(self) -> bool:
        return True

    @property
    def is_overtaken(self) -> bool:
        return False

    def share(self, place: str) -> None: ...

    def free(self) -> None: ...

    @property
    def undecided(self) -> bool:
        return False

    def reclaim(self) -> bool:
        return True

    def reclaim_freed(self) -> bool:
        return False

    def leave(self) -> None: ...


@dataclass(eq=False)
class OldLease(_LeaseArbiter):
    """The old side, which gives leases of ``seconds``. All but ``is_overtaken`` is for the control thread."""

    seconds: float
    # When the last lease that was given is over at the latest (steady, ns).
    _until: int | None = field(default=None, init=False)
    _recalled: bool = field(default=False, init=False)  # no lease is given any more
    _taken: bool = field(default=False, init=False)  # the new side has reported its first write
    _freed: bool = field(default=False, init=False)  # the new side never writes again
    _has: bool = field(default=False, init=False)  # this side writes again

    def claim(self) -> Claimed:
        """The answer to the new side, which asks for the right."""
        if self._has or self._freed:
            return Claimed(how="refused")
        if self._taken:
            return Claimed(how="yours")
        if self._recalled:
            return Claimed(how="recalled")
        self._until = self.steady() + round(self.seconds * LEASE_SLACK * 1e9)
        return Claimed(how="leased", seconds=self.seconds)

    @property
    def is_overtaken(self) -> bool:
        """True once a lease is given, as the lease cannot be looked up, until this side writes again."""
        return self._until is not None and not self._has

    def share(self, place: str) -> None:
        self._taken = True

    def free(self) -> None:
        self._freed = True

    @property
    def undecided(self) -> bool:
        return not (self._has or self._taken or self._freed)

    def reclaim(self) -> bool:
        self._recalled = True
        self._has = self._has or self._freed or (not self._taken and self._is_over())
        return self._has

    def reclaim_freed(self) -> bool:
        return self._freed and self.reclaim()

    def _is_over(self) -> bool:
        """Return whether the new side has no lease any more."""
        return self._until is None or self.steady() > self._until


@dataclass(eq=False)
class NewLease(_LeaseArbiter):
    """The new side. It writes while it has a lease, and for good once the old side has confirmed its first write."""

    _until: int = field(default=0, init=False)  # when its lease is over (steady, ns)
    _used: bool = field(default=False, init=False)
    _confirmed: bool = field(default=False, init=False)
    _ended: bool = field(default=False, init=False)  # it never writes again
    _told: bool = field(default=False, init=False)  # and the old side knows
    _mutex: threading.Lock = field(default_factory=threading.Lock, init=False)

    def begin(self, output: int) -> bool:
        return self.admits()

    def admits(self) -> bool:
        with self._mutex:
            admitted = not self._ended and self._may_write()
            self._used = self._used or admitted
            return admitted

    def _may_write(self) -> bool:
        return self._confirmed or self.steady() < self._until

    def renounce(self) -> bool:
        with self._mutex:
            self._ended = self._ended or not self._used
            return not self._used

    def give_back(self) -> None:
        with self._mutex:
            self._ended = True

    @property
    def settled(self) -> bool:
        return self._confirmed or self._ended

    @property
    def owes_word(self) -> bool:
        """Return whether the old side is still to be told that this one never writes again."""
        return self._ended and not self._told

    def answered(self, sent: int, answer: Claimed) -> None:
        """The old side has answered ``answer`` to a request of the moment ``sent`` (steady, ns)."""
        match answer.how:
            case "leased":
                with self._mutex:
                    self._until = max(self._until, sent + round(answer.seconds * 1e9))
            case "yours":
                self.confirm()
            case "recalled":
                self.refused = self.renounce() or self.refused
            case "refused":
                self.lose()

    def confirm(self) -> None:
        """The old side has heard of the first write, and never writes again by itself."""
        self._confirmed = True

    def old_has_ended(self) -> None:
        """The process of the old side has ended."""
        self._confirmed = self._told = True

    def lose(self) -> None:
        """The old side writes again."""
        with self._mutex:
            self._ended = self._told = self.refused = True

    def told(self) -> None:
        self._told = True


@dataclass(eq=False)
class OldPeer:
    """The old side ``name``, as the new one calls it: by ``channel(timeout)``, and always the process ``uuid``.

    Another one that has its name knows nothing of the cut, and would say that it writes. ``lease``: what there is from
    the old side, where that is on another host.
    """

    name: str
    channel: Callable[[float], Awaitable[Channel]]
    uuid: str = ""
    lease: NewLease | None = None

    async def _request(self, command: Command[Any], timeout: float) -> Reply:
        """Raises BackendError."""
        channel = await self.channel(timeout)
        self.uuid = self.uuid or channel.greeting.uuid
        if channel.greeting.uuid != self.uuid:
            if self.lease is not None:  # who has ended never writes again
                self.lease.old_has_ended()
            raise Unreachable(f"{self.name} has ended, and another process has its name")
        return await channel.request(command, timeout=timeout)

    async def ask(self, command: Command[R], timeout: float) -> R:
        """The reply to ``command``. Raises BackendError and CommandRefused."""
        return result_of(await self._request(command, timeout), command)

    async def report(self, taken: CutTakenCommand, timeout: float) -> bool:
        """Report the first write, or a failure; whether the old side writes again. Raises BackendError."""
        lease = self.lease
        if lease is not None and lease.settled and not taken.failed:
            return lease.refused
        reply = await self._request(taken, timeout)
        resumed = not reply.ok or result_of(reply, taken).resumed
        if lease is not None and not resumed:
            lease.confirm()
        return resumed


@dataclass(eq=False)
class LeaseKeeper:
    """The new side's messages about its ``lease``: requests for it, and the word that it is given back.

    ``ask`` sends a command to the old side; raises BackendError or CommandRefused where that does not carry it out.
    """

    cut: str
    lease: NewLease
    host: Host
    ask: Callable[[Command[Any], float], Awaitable[Any]]
    _telling: bool = field(default=False, init=False)

    async def begin(self, peer: str) -> None:
        """Ask before the moment of the cut. Raises CommandRefused where ``peer``, the old side, gives no lease."""
        try:
            await self.claim()
        except (BackendError, CommandRefused) as error:
            raise CommandRefused(f"{peer} gave no lease: {error}") from None
        if self.lease.refused:
            raise CommandRefused(f"{peer} gave no lease: it writes again")

    async def claim(self) -> None:
        """Ask once. Raises BackendError and CommandRefused."""
        sent = self.host.steady()
        self.lease.answered(sent, await self.ask(CutClaimCommand(cut=self.cut), ANSWER))

    async def run(self) -> None:
        """Ask again and again, until the old side has confirmed the first write, or this one writes nothing more."""
        while not self.lease.settled:
            await self.host.sleep(RENEWAL)
            with suppress(BackendError, CommandRefused):
                await self.claim()
        await self.tell()

    async def tell(self) -> None:
        """Notify the old side if this side never writes again; that takes until it can be reached."""
        if self._telling:
            return
        self._telling, pause = True, TELLING
        while self.lease.owes_word:
            try:
                await self.ask(CutTakenCommand(cut=self.cut, failed=True), ANSWER)
                self.lease.told()
            except (BackendError, CommandRefused):
                await self.host.sleep(pause)
                pause = min(2 * pause, TELLING_LONGEST)
        self._telling = False
