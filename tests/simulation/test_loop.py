"""The seeded loop: virtual time, an order that is drawn, and the end of what waits for ever."""

from __future__ import annotations

import asyncio

import pytest

from midstride.errors import BackendError
from midstride.runtime.timeouts import within
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
