"""The task of one side of a cut in virtual time: for how long it waits, and when it is over."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from midstride.backends.simulator.virtual_loop import run
from midstride.errors import CommandRefused
from midstride.node.author.ports import OutputLink
from midstride.node.handover.arbiter import Arbiter
from midstride.node.handover.cut import GRACE, IncomingCut, OutgoingCut, OutgoingSide
from midstride.node.handover.cut_protocol import SLOW_TICK, TICK, CutInTask, CutOutTask
from midstride.runtime.timeouts import within
from tests.node.test_cut import Owner, link_of, write
from tests.node.virtual import SECOND, Rights, VirtualHost, seconds

MOMENT = 1.0  # of the cut (s)


def in_virtual_time(main: Callable[[], Awaitable[None]]) -> None:
    async def opened() -> None:
        await main()

    run(opened())


def new_side(rights: Arbiter, *links: OutputLink, latches: tuple[OutputLink, ...] = ()) -> CutInTask:
    side = IncomingCut(links, VirtualHost().host, rights, round(MOMENT * SECOND), latches=latches)
    side.arm()
    return CutInTask(side.host, lambda: None, side, report=None)


def old_side(side: OutgoingSide) -> CutOutTask:
    side.arm()
    return CutOutTask(side.host, lambda: None, side, resume_after=1.0)


@pytest.mark.parametrize(("driven", "waits"), [("message", GRACE), ("none", 0.0)])
def test_what_was_written_once_is_published_when_no_message_can_be_in_transit_any_more(
    driven: Any, waits: float
) -> None:
    """Where messages drive it, one from just before the moment may still make it write."""

    async def main() -> None:
        link, published = link_of(Owner(driven=driven, rate=None))
        task = new_side(Rights(), link, latches=(link,))
        write(link, "once")
        running = asyncio.ensure_future(task.run())
        at = MOMENT + waits
        await asyncio.sleep(at - TICK)
        assert published == []
        await asyncio.sleep(3 * TICK + (0.01 if waits == 0.0 else 0.0))  # it looks at the clock every 10 ms
        assert published == ["once"]
        await running
        assert task.outcome == "done"

    in_virtual_time(main)


def test_the_new_side_keeps_its_arbiter_until_the_old_one_can_no_longer_have_the_right_back() -> None:
    async def main() -> None:
        rights = Rights(settled=False)
        link, _ = link_of(Owner(driven="none", rate=None))
        running = asyncio.ensure_future(new_side(rights, link).run())
        await asyncio.sleep(MOMENT + 0.1)
        write(link, "first")
        await asyncio.sleep(10 * SLOW_TICK)
        assert rights.left_at is None and not running.done()
        rights.settled = True
        await asyncio.wait_for(running, 2 * SLOW_TICK)
        assert rights.left_at == pytest.approx(seconds(), abs=SLOW_TICK)

    in_virtual_time(main)


async def done(task: CutOutTask) -> asyncio.Future[None]:
    """The old side has done its part, and watches the new one."""
    running = asyncio.ensure_future(task.run())
    await task.taken(failed=False)
    async with within(5.0):
        await task.finished.wait()
    assert task.outcome == "done"
    return running


def test_the_old_side_watches_the_new_one_for_as_long_as_it_has_an_attachment_that_the_cut_keeps_closed() -> None:
    async def main() -> None:
        rights = Rights()
        link, _ = link_of(Owner())
        side = OutgoingCut([link], VirtualHost().host, rights, round(MOMENT * SECOND))
        task = old_side(side)
        running = await done(task)
        await asyncio.sleep(20 * SLOW_TICK)
        assert not running.done() and rights.left_at is None
        await asyncio.wait_for(task.watch_successor(), SLOW_TICK / 2)  # it is watched already
        link.destroy()
        await asyncio.wait_for(running, 2 * SLOW_TICK)
        assert rights.left_at is not None

    in_virtual_time(main)


@pytest.mark.parametrize("wanted", [False, True])
def test_without_outputs_the_old_side_watches_only_where_it_is_wanted_again(wanted: bool) -> None:
    """The manager has asked it to go on, while the new one could still take over; then that one ends."""

    async def main() -> None:
        rights = Rights()
        task = old_side(OutgoingSide([], VirtualHost().host, rights))
        running = asyncio.ensure_future(task.run())
        if wanted:
            with pytest.raises(CommandRefused, match="can still write"):
                await task.cancel()
        await task.taken(failed=False)
        async with within(1.0):
            await task.finished.wait()
        assert task.outcome == "done"
        await asyncio.sleep(20 * SLOW_TICK)
        assert running.done() is not wanted
        rights.frees = True
        await asyncio.sleep(2 * SLOW_TICK)
        assert running.done() and task.outcome == ("resumed" if wanted else "done")

    in_virtual_time(main)


def test_a_new_side_is_detached_when_it_has_lost_its_last_attachment() -> None:
    (one, _), (other, _) = link_of(Owner(), "/a"), link_of(Owner(), "/b")
    task = new_side(Rights(), one, other)
    seen = [task.is_detached]
    for link in (one, other):
        link.destroy()
        seen.append(task.is_detached)
    assert seen == [False, False, True]
    assert not new_side(Rights()).is_detached, "it never had one"
