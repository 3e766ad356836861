"""Bounded waiting on the control thread: what is given up, and what goes on."""

from __future__ import annotations

import asyncio
import gc
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, Final

import pytest

from midstride.backends.simulator.virtual_loop import run
from midstride.errors import CommandRefused
from midstride.node.data.mode_switch import DataExecutor, within
from tests.node.virtual import T, VirtualHost

HOST: Final[Any] = SimpleNamespace(sleep=asyncio.sleep)


def test_what_only_waits_is_given_up_with_the_wait() -> None:
    async def main() -> None:
        async def look_again_and_again() -> None:
            while True:
                await asyncio.sleep(0.001)

        for waiting in (asyncio.Event().wait(), look_again_and_again()):
            assert await within(HOST, waiting, 0.01) is None
            await asyncio.sleep(0)
            assert asyncio.all_tasks() == {asyncio.current_task()}

    asyncio.run(main())


def test_work_that_was_begun_goes_on() -> None:
    async def main() -> None:
        work: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        assert await within(HOST, work, 0.01) is None
        work.set_result(1)
        finished = await within(HOST, work, 0.01)
        assert finished is work and work.result() == 1

    asyncio.run(main())


def test_what_fails_after_it_is_no_longer_awaited_is_not_logged_as_an_error_that_nothing_has_retrieved() -> None:
    async def main() -> None:
        loop, logged = asyncio.get_running_loop(), list[str]()
        loop.set_exception_handler(lambda _, context: logged.append(context["message"]))
        work: asyncio.Future[int] = loop.create_future()
        assert await within(HOST, work, 0.01) is None
        work.set_exception(ValueError("too late"))
        await asyncio.sleep(0)
        del work
        gc.collect()
        assert logged == []

    asyncio.run(main())


class SlowHost(VirtualHost):
    """The data thread comes to its work at once, and is done with it after 1.5 s."""

    async def on_data(self, function: Callable[[], T]) -> T:
        found = function()
        await self.sleep(1.5)
        return found


def test_work_of_the_data_thread_that_has_begun_in_time_has_as_long_again_to_end() -> None:
    data = DataExecutor(SlowHost().host, lambda: "")

    async def main() -> None:
        assert await data.run(lambda: "done", 1.0) == "done"
        with pytest.raises(CommandRefused, match=r"^it has started, but did not end within another 0\.5 s$"):
            await data.run(lambda: "done", 0.5)

    run(main())
