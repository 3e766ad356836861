"""The command queue: one command at a time, in order of arrival, and what the others learn of it."""

from __future__ import annotations

import asyncio

import pytest

from midstride.backends.simulator.virtual_clock import SimulatedClock
from midstride.backends.simulator.virtual_loop import run
from midstride.runtime.command_queue import CommandQueue
from midstride.runtime.records.events import EventLog
from midstride.runtime.records.status_forms import RunningCommand


async def queue() -> CommandQueue:
    clock = SimulatedClock()
    clock.follow(asyncio.get_running_loop())
    return CommandQueue(clock, EventLog())


def state(commands: CommandQueue) -> tuple[bool, bool]:
    """Whether the command in progress is the last one, and whether it knows that another one waits."""
    return commands.is_last, commands.another_waits.is_set()


def test_commands_run_in_order_of_arrival_and_each_says_what_it_waits_for() -> None:
    async def main() -> None:
        commands, ran = await queue(), list[str]()

        async def command(words: str) -> None:
            async with commands.run(words, id=words):
                ran.append(words)
                await asyncio.sleep(1)

        await asyncio.gather(*(command(words) for words in ("first", "second", "third")))
        assert ran == ["first", "second", "third"]
        assert [(event.kind, event.id) for event in commands.events.since() if event.kind == "command"] == [
            ("command", words) for words in ran
        ]
        assert [event.words for event in commands.events.since() if event.kind == "waiting"] == [
            "`second` waits for `first`",
            "`third` waits for `first`",
        ]

    run(main())


def test_a_command_knows_whether_another_one_waits_also_one_that_is_given_up() -> None:
    async def main() -> None:
        commands = await queue()

        async def second() -> None:
            async with commands.run("second"):
                pass

        async with commands.run("first"):
            assert state(commands) == (True, False)
            waiting = asyncio.ensure_future(second())
            await asyncio.sleep(1)
            assert state(commands) == (False, True)
            assert commands.running == RunningCommand("first", 1.0)
            waiting.cancel()
            with pytest.raises(asyncio.CancelledError):
                await waiting
            assert state(commands) == (True, False)
        assert commands.running is None

    run(main())


def test_the_command_in_progress_is_shown_with_how_long_it_has_run() -> None:
    async def main() -> None:
        commands = await queue()
        await asyncio.sleep(2)
        async with commands.run("change"):
            await asyncio.sleep(1.5)
            assert commands.running == RunningCommand("change", 1.5)
        assert commands.running is None

    run(main())


def test_listeners_are_called_when_a_command_has_ended_and_before_the_next_one_begins() -> None:
    async def main() -> None:
        commands, seen = await queue(), list[tuple[str | None, bool]]()
        commands.listeners.append(lambda: seen.append((commands.current, commands.lock.locked())))

        async def fails() -> None:
            async with commands.run("fails"):
                assert seen == []
                raise ValueError("no such thing")

        with pytest.raises(ValueError, match="no such thing"):
            await fails()
        assert seen == [(None, True)] and not commands.lock.locked()

    run(main())


def test_between_commands_no_command_changes_the_system() -> None:
    async def main() -> None:
        commands = await queue()
        async with commands.between():
            running = asyncio.ensure_future(commands.run("waits").__aenter__())
            await asyncio.sleep(1)
            assert not running.done() and not commands.is_changing
        await running
        assert commands.is_changing

    run(main())
