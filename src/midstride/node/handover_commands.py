"""The commands of a hand-over: the time grid, the two sides of a cut, and what passes between peers."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Awaitable, Callable
from typing import Any, Final

from midstride.errors import BackendError, CommandRefused
from midstride.node.arguments import Arguments
from midstride.node.attachments import Attachments
from midstride.node.cut import IncomingCut, OutgoingCut
from midstride.node.cut_protocol import CutInTask, CutOutTask
from midstride.node.host import Host
from midstride.node.mode_switch import DataExecutor, within
from midstride.node.ports import OutputLink
from midstride.wire.messages import Command, Reply

# How long making the acquaintance of a peer may take (s), and one attempt at it.
MEET_TIMEOUT: Final = 5.0
MEET_ATTEMPT: Final = 0.5
# How many cuts that are over can still be asked about, or cancelled.
REMEMBERED: Final = 50


class HandoverCommands:
    def __init__(self, attachments: Attachments, host: Host, data: DataExecutor, changed: Callable[[], None]) -> None:
        self.token = ""
        self._attachments = attachments
        self._host = host
        self._data = data
        self._changed = changed
        # Both sides of a cut may be here: one output of the component can hand over to another.
        self._sides: dict[str, list[CutOutTask | CutInTask]] = {}
        self._tasks: set[asyncio.Task[None]] = set()

    def close(self) -> None:
        """The component ends: no side goes on."""
        for task in self._tasks:
            task.cancel()

    # -- before ------------------------------------------------------------------------------------

    async def grid(self, arguments: Arguments) -> dict[str, Any]:
        port, topic = arguments.text("port"), arguments.text_or("topic", "")
        owner = self._attachments.output(port).owner
        if owner is None:
            raise CommandRefused("the component has not begun yet")
        rate = owner.rate
        return {
            "trigger": owner.mode.driven,
            "epoch": None if rate is None else rate.slot,
            "period": None if rate is None else rate.period,
            "now": self._host.now(),
            "readers": self._attachments.link(port, topic).publisher.matched() if topic else None,
        }

    async def meet(self, arguments: Arguments) -> dict[str, Any]:
        """Find the peer and have it answer, so that `taken` will not wait for discovery."""
        peer = arguments.text("peer")
        timeout = arguments.seconds("timeout", MEET_TIMEOUT)
        deadline = self._host.steady() + int(timeout * 1e9)
        while True:
            try:
                reply = await self._call(peer, "ping", {}, MEET_ATTEMPT)
                break
            except BackendError as error:
                if self._host.steady() >= deadline:
                    raise CommandRefused(f"{peer} did not answer within {timeout:g} s: {error}") from None
                await self._host.sleep(0.02)
        if not reply.ok:
            raise CommandRefused(f"{peer} refused a ping: {reply.refused}")
        return {}

    # -- the cut -----------------------------------------------------------------------------------

    async def cut_out(self, arguments: Arguments) -> dict[str, Any]:
        cut, at, links = self._agreed(arguments, CutOutTask, gate="open")
        side = OutgoingCut(links, at, self._host)
        await self._arm(at, side.arm)
        self._begin(cut, CutOutTask(self._host, self._changed, side, arguments.seconds("resume_after")))
        return {}

    async def cut_in(self, arguments: Arguments) -> dict[str, Any]:
        cut, at, links = self._agreed(arguments, CutInTask, gate="closed")
        peer, epoch = arguments.text("peer"), arguments.maybe_whole("epoch")
        latches = [
            link for link, swap in zip(links, arguments.tables("swaps"), strict=True) if swap.get("latch") is True
        ]
        side = IncomingCut(links, at, self._host, latches)
        await self._arm(at, lambda: side.arm(epoch))
        rate_driven = all(link.output.owner is not None and link.output.owner.rate is not None for link in links)
        self._begin(cut, CutInTask(self._host, self._changed, side, self._teller(cut, peer), rate_driven))
        return {}

    async def cancel_cut(self, arguments: Arguments) -> dict[str, Any]:
        for side in self._of(arguments.text("cut")):
            await side.cancel()
        return {}

    async def await_cut(self, arguments: Arguments) -> dict[str, Any]:
        sides = self._of(arguments.text("cut"))
        if not sides:
            raise CommandRefused(f"there is no cut {arguments.text('cut')}")
        over = asyncio.gather(*(side.finished.wait() for side in sides))
        await within(self._host, over, arguments.seconds("timeout", 5.0))
        told: dict[str, Any] = {}
        for side in sorted(sides, key=lambda side: side.outcome != "done", reverse=True):
            told = {**side.told(), **told}  # of two sides here, what keeps the cut from being done
        return told

    async def taken(self, arguments: Arguments) -> dict[str, Any]:
        """From the new side. Of a cut that is not known here nothing was given up, so this side writes."""
        old = [side for side in self._of(arguments.text("cut")) if isinstance(side, CutOutTask)]
        return {"resumed": any(side.taken() for side in old) if old else True}

    # -- parts -------------------------------------------------------------------------------------

    def _of(self, cut: str) -> list[CutOutTask | CutInTask]:
        """The sides of a cut that are here."""
        return self._sides.get(cut, [])

    def _agreed(self, arguments: Arguments, kind: type, gate: str) -> tuple[str, int, list[OutputLink]]:
        """The cut's id, its moment and its attachments. Raises CommandRefused where one is not fit for it."""
        cut, at = arguments.text("cut"), arguments.whole("at")
        if any(isinstance(side, kind) for side in self._of(cut)):
            raise CommandRefused(f"cut {cut} has been agreed before")
        links = []
        for swap in arguments.tables("swaps"):
            of = Arguments("a swap of the cut", swap)
            link = self._attachments.link(of.text("port"), of.text("topic"))
            if link.cut is not None:
                raise CommandRefused(f"{link} is part of another cut under way")
            if link.gate != gate:
                raise CommandRefused(f"the gate of {link} is {link.gate}, and must be {gate} before this side of a cut")
            links.append(link)
        if not links:
            raise CommandRefused("a cut needs at least one swap")
        return cut, at, links

    async def _arm(self, at: int, arm: Callable[[], None]) -> None:
        """Tell the data side of the cut, before its moment or not at all."""
        left = (at - self._host.now()) / 1e9

        def in_time() -> None:
            if self._host.now() >= at:
                raise CommandRefused("the agreed moment of the cut has passed already")
            arm()

        if left <= 0:
            raise CommandRefused(f"the agreed moment of the cut passed {-left:.3f} s ago")
        await self._data.run(in_time, left)

    def _begin(self, cut: str, side: CutOutTask | CutInTask) -> None:
        self._sides.setdefault(cut, []).append(side)
        over = [cut for cut, sides in self._sides.items() if all(earlier.finished.is_set() for earlier in sides)]
        for old in over[:-REMEMBERED]:
            del self._sides[old]
        task = asyncio.get_running_loop().create_task(side.run())
        self._tasks.add(task)
        task.add_done_callback(self._ended)

    def _ended(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            self._host.logger.error(f"a side of a cut failed: {type(error).__name__}: {error}")

    def _teller(self, cut: str, peer: str) -> Callable[[float], Awaitable[Reply]]:
        return lambda timeout: self._call(peer, "taken", {"cut": cut}, timeout)

    async def _call(self, peer: str, op: str, arguments: dict[str, Any], timeout: float) -> Reply:
        return await self._host.call_peer(peer, Command(op, arguments, uuid.uuid4().hex, self.token), timeout)
