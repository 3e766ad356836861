"""The commands that change modes, and the one that holds calls until several components change theirs.

Control thread.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from midstride.errors import CommandRefused
from midstride.node.component_host import Host
from midstride.node.data.functionality_runner import FunctionalityRunner
from midstride.node.data.mode_switch import DataExecutor, Hold, ModeSwitch, within
from midstride.wire import commands, replies


class Revision:
    """Counts the changes of a component. Both threads count up, so it has a lock; reading needs none.

    ``failure``: the last change that user code made by raising, as its number and in words.
    """

    def __init__(self) -> None:
        self.value = 0
        self.failure = (0, "")
        self._lock = threading.Lock()

    def bump(self, failure: str = "") -> None:
        with self._lock:
            if failure:
                self.failure = (self.value + 1, failure)
            self.value += 1


@dataclass
class ModeCommands:
    """Changes the modes of a component, and holds its calls. ``before``: what its author has called first, if any."""

    host: Host
    data: DataExecutor
    runners: Sequence[FunctionalityRunner]
    revision: Revision
    before: Callable[[Mapping[str, str]], Awaitable[None]] | None
    _hold: Hold | None = None
    _expiry: asyncio.Task[None] | None = None  # of the hold

    async def switch(self, command: commands.ModesCommand, expected: int | None) -> replies.PreviousModes:
        indices = {name: self._mode_index(name, mode) for name, mode in command.modes.items()}
        before = self.before
        if before is None:
            return await self._switch_modes(command, indices, expected)
        current = {runner.name: runner.current_mode() for runner in self.runners if runner.name in indices}
        await before(command.modes)
        try:
            return await self._switch_modes(command, indices, expected)
        except CommandRefused:
            with contextlib.suppress(CommandRefused):
                await before(current)
            raise

    async def _switch_modes(
        self, command: commands.ModesCommand, indices: Mapping[str, int], expected: int | None
    ) -> replies.PreviousModes:
        targets = {runner: indices[runner.name] for runner in self.runners if runner.name in indices}
        ended = asyncio.Event()
        on_ended = partial(asyncio.get_running_loop().call_soon_threadsafe, ended.set)

        def guard() -> str | None:
            if expected is not None and expected != self.revision.value:
                return "a functionality has degraded by itself meanwhile: observe the component again, then retry"
            return None

        switch = ModeSwitch(targets, command.because, guard, on_ended, hold=self.take_hold())
        attempt = asyncio.ensure_future(self.host.on_data(switch.attempt))
        attempt.add_done_callback(self._log_failure)
        if await within(self.host, ended.wait(), command.timeout) is None and switch.decision.make():
            self.host.on_data(switch.release)
            raise CommandRefused(
                f"the change of {', '.join(indices)} was withdrawn: "
                f"user code did not return within {command.timeout:.3g} s{self.data.busy()}"
            )
        await ended.wait()
        if switch.refused is not None:
            raise CommandRefused(switch.refused)
        return replies.PreviousModes(before=switch.before, at=None if switch.hold is None else switch.at)

    async def hold(self, command: commands.HoldCommand) -> replies.Done:
        names = {runner.name: runner for runner in self.runners}
        if unknown := [name for name in command.functionalities if name not in names]:
            raise CommandRefused(f"there is no functionality {unknown[0]}; the functionalities are: {', '.join(names)}")
        if (earlier := self.take_hold()) is not None:
            self.host.on_data(earlier.release)
        if not command.seconds:
            return replies.Done()
        held = asyncio.Event()
        on_held = partial(asyncio.get_running_loop().call_soon_threadsafe, held.set)
        hold = Hold([names[name] for name in command.functionalities], on_held)
        self.host.on_data(hold.attempt)
        if await within(self.host, held.wait(), command.timeout) is None:
            self.host.on_data(hold.release)
            raise CommandRefused(f"user code did not return within {command.timeout:.3g} s{self.data.busy()}")
        self._hold = hold
        self._expiry = asyncio.ensure_future(self._expire(command.seconds))
        return replies.Done()

    async def _expire(self, seconds: float) -> None:
        """Whoever asked for the hold may be gone."""
        await self.host.sleep(seconds)
        self._expiry = None
        if (hold := self.take_hold()) is not None:
            self.host.on_data(hold.release)

    def take_hold(self) -> Hold | None:
        """The hold in force, if any, which the caller ends."""
        hold, self._hold = self._hold, None
        if self._expiry is not None:
            self._expiry.cancel()
            self._expiry = None
        return hold

    def _log_failure(self, work: asyncio.Future[Any]) -> None:
        if not work.cancelled() and (error := work.exception()) is not None:
            self.host.logger.error(f"changing modes failed: {type(error).__name__}: {error}")

    def _mode_index(self, functionality: str, mode: object) -> int:
        runner = next((runner for runner in self.runners if runner.name == functionality), None)
        if runner is None:
            listed = ", ".join(runner.name for runner in self.runners)
            raise CommandRefused(f"there is no functionality {functionality}; the functionalities are: {listed}")
        names = [declared.name for declared in runner.chain]
        if mode not in names:
            raise CommandRefused(f"{functionality} has no mode {mode!r}; its modes are: {', '.join(names)}")
        return names.index(str(mode))
