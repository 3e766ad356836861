"""Works that run at the same time: what is raised, and that a cancellation ends them."""

from __future__ import annotations

import asyncio

import pytest

from midstride.runtime.cancellation import all_of


@pytest.mark.parametrize("turns", range(5))
def test_a_cancellation_is_not_lost_where_a_work_raises_at_the_same_moment(turns: int) -> None:
    """However many turns of the loop are between the two."""

    async def main() -> None:
        begun: asyncio.Future[None] = asyncio.get_running_loop().create_future()

        async def raises() -> None:
            await begun
            raise ValueError("it has exited")

        task = asyncio.ensure_future(all_of([raises(), asyncio.sleep(3600)]))
        await asyncio.sleep(0)
        begun.set_result(None)
        for _ in range(turns):
            await asyncio.sleep(0)
        with pytest.raises(asyncio.CancelledError if task.cancel() else ValueError):
            await task

    asyncio.run(main())


def test_the_first_failure_is_raised_and_ends_the_others() -> None:
    ended: list[str] = []

    async def waits() -> None:
        try:
            await asyncio.sleep(3600)
        finally:
            ended.append("waits")

    async def raises() -> None:
        await asyncio.sleep(0)
        raise ValueError("it has exited")

    async def main() -> None:
        with pytest.raises(ValueError, match="it has exited"):
            await all_of([waits(), raises()])
        assert ended == ["waits"]
        assert await all_of([asyncio.sleep(0, number) for number in (1, 2)]) == [1, 2]
        assert await all_of([]) == []

    asyncio.run(main())
