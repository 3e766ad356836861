"""The event log: clients read from any point, and follow."""

from __future__ import annotations

import asyncio

from midstride.runtime.records.events import EventLog


def test_a_follower_has_what_it_asked_for_and_then_waits_for_each_new_event() -> None:
    async def main() -> None:
        log, heard = EventLog(), list[int]()
        for words in ("one", "two", "three"):
            log.add("note", words)

        async def follow() -> None:
            async for event in log.follow(1):
                heard.append(event.n)

        following = asyncio.ensure_future(follow())
        await asyncio.sleep(0)
        assert heard == [2, 3] and len(log.wakers) == 1
        await asyncio.sleep(0)
        assert heard == [2, 3], "it waits"
        log.add("note", "four")
        log.add("note", "five")
        for _ in range(3):
            await asyncio.sleep(0)
        assert heard == [2, 3, 4, 5]
        following.cancel()
        await asyncio.gather(following, return_exceptions=True)
        assert len(log.wakers) == 0

    asyncio.run(main())


def test_what_is_from_an_earlier_manager_is_answered_with_all_there_is() -> None:
    log, heard = EventLog(), list[str]()
    log.listeners.append(lambda event: heard.append(event.words))
    assert (log.last, log.since(), log.since(7)) == (0, [], [])
    for words in ("one", "two"):
        log.add("note", words)
    assert log.last == 2 and heard == ["one", "two"]
    assert [[event.words for event in log.since(n)] for n in (0, 1, 2, 3)] == [
        ["one", "two"],
        ["two"],
        [],
        ["one", "two"],
    ]
