"""The seeded loop: virtual time, an order that is drawn, and the end of what waits for ever."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

import pytest

from midstride.backends.simulator import Simulator
from midstride.errors import BackendError
from midstride.runtime.timeouts import within
from midstride.simulation.killable_manager import Life
from midstride.simulation.loop import SeededLoop, run


def order(seed: int) -> tuple[list[int], list[int]]:
    """The order in which tasks that are ready at once run, and timers of one moment fire."""
    ready: list[int] = []
    timers: list[int] = []

    async def one(number: int) -> None:
        ready.append(number)
        await asyncio.sleep(1.0)
        timers.append(number)

    async def main() -> None:
        await asyncio.gather(*(one(number) for number in range(6)))

    run(SeededLoop(seed), main())  # type: ignore[abstract]
    return ready, timers


def test_the_order_of_what_is_ready_is_drawn_from_the_seed() -> None:
    assert order(1) == order(1)
    assert len({str(order(seed)) for seed in range(20)}) == 20
    assert all(sorted(part) == list(range(6)) for seed in range(20) for part in order(seed))


def test_what_one_task_does_stays_in_order_and_time_jumps() -> None:
    seen: list[tuple[float, int]] = []
    loop = SeededLoop(3)  # type: ignore[abstract]

    async def main() -> None:
        queue: asyncio.Queue[int] = asyncio.Queue()
        for number in range(5):
            queue.put_nowait(number)
        while not queue.empty():
            seen.append((loop.time(), await queue.get()))
            await asyncio.sleep(600)

    run(loop, main())
    assert seen == [(600.0 * number, number) for number in range(5)]


def test_a_timeout_and_a_cancelled_timer() -> None:
    loop = SeededLoop(4)  # type: ignore[abstract]

    async def main() -> float:
        loop.call_later(0.5, pytest.fail, "it was cancelled").cancel()
        with pytest.raises(asyncio.TimeoutError):
            async with within(2.0):
                await asyncio.sleep(5.0)
        return loop.time()

    assert run(loop, main()) == 2.0


def test_a_deadlock_and_a_livelock_end() -> None:
    async def waits() -> None:
        await asyncio.get_running_loop().create_future()

    with pytest.raises(BackendError, match=r"deadlock at 0\.0"):
        run(SeededLoop(5), waits())  # type: ignore[abstract]

    async def spins() -> None:
        while True:
            await asyncio.sleep(0)

    with pytest.raises(BackendError, match=r"livelock at 0\.0"):
        run(SeededLoop(6), spins())  # type: ignore[abstract]


def test_an_error_that_nothing_catches_is_kept() -> None:
    loop = SeededLoop(7)  # type: ignore[abstract]

    async def main() -> None:
        loop.call_soon(lambda: 1 / 0)
        await asyncio.sleep(1)

    run(loop, main())
    assert isinstance(loop.errors[0]["exception"], ZeroDivisionError)


def test_what_is_left_is_cancelled_in_the_same_order_again() -> None:
    async def waits(number: int, ended: list[int]) -> None:
        try:
            await asyncio.get_running_loop().create_future()
        finally:
            ended.append(number)

    def order_at_the_end(kept: int) -> list[int]:
        ended: list[int] = []
        tasks = []
        memory = []  # which moves what is made after it to other addresses

        async def main() -> None:
            for number in range(40):
                memory.append(bytearray(100 * kept * (number % 3)))
                tasks.append(asyncio.ensure_future(waits(number, ended)))
            await asyncio.sleep(1.0)

        run(SeededLoop(8), main())  # type: ignore[abstract]
        return ended

    assert len({str(order_at_the_end(kept)) for kept in range(10)}) == 1


def test_what_does_not_end_when_it_is_cancelled_is_named() -> None:
    async def never() -> None:
        await asyncio.get_running_loop().create_future()

    async def waits_again() -> None:
        try:
            await never()
        except asyncio.CancelledError:  # and not where it is collected as garbage, later
            await never()

    async def begins_another() -> None:
        try:
            await never()
        except asyncio.CancelledError:
            kept.append(asyncio.ensure_future(begins_another()))

    async def begins_one() -> None:
        try:
            await never()
        finally:
            kept.append(asyncio.ensure_future(never()))

    kept: list[asyncio.Task[None]] = []

    async def main(left: Callable[[], Coroutine[Any, Any, None]]) -> None:
        kept.append(asyncio.ensure_future(left()))
        await asyncio.sleep(1.0)

    with pytest.raises(BackendError, match=r"^deadlock at 1\.0.* did not end: .*waits_again in .*never$"):
        run(SeededLoop(9), main(waits_again))  # type: ignore[abstract]
    with pytest.raises(BackendError, match=r"^livelock at 1\.0.* did not end: .*begins_another$"):
        run(SeededLoop(9), main(begins_another))  # type: ignore[abstract]
    kept.clear()
    run(SeededLoop(9), main(begins_one))  # type: ignore[abstract]
    assert [task.cancelled() for task in kept] == [True, True]


@pytest.mark.parametrize("waits_before", [False, True])
def test_what_a_killed_manager_left_under_way_ends_with_the_simulation(waits_before: bool) -> None:
    """Also where it comes to wait after the burial, to clean up after itself."""
    simulator = Simulator()
    life = Life(simulator)
    ended: list[str] = []

    async def under_way() -> None:
        try:
            await life.backend.clock.sleep(5.0)
        finally:
            try:
                await life.backend.clock.sleep(5.0)
            finally:
                ended.append("under way")

    async def main() -> None:
        tasks.append(asyncio.ensure_future(under_way()))
        await asyncio.sleep(1.0)
        life.kill()
        await asyncio.sleep(10.0 if waits_before else 0.0)
        life.bury()

    tasks: list[asyncio.Task[None]] = []
    run(SeededLoop(10), main())  # type: ignore[abstract]
    assert ended == ["under way"]
