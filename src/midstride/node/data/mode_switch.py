"""Changes on the data thread that happen exactly once, between two calls of user code, or not at all.

docs/protocols/modes.md: a change is acknowledged once no call of the old mode runs; one that is
not possible within its time-out is withdrawn, and must not happen later.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable, Callable, Coroutine, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

from midstride.errors import CommandRefused
from midstride.node.component_host import Host
from midstride.node.data.functionality_runner import CAUGHT, FunctionalityRunner

T = TypeVar("T")


async def within(host: Host, awaitable: Awaitable[T], seconds: float) -> asyncio.Future[T] | None:
    """The finished future of ``awaitable``, or None where ``seconds`` on the steady clock pass first.

    A future that is not finished goes on: work on the data thread cannot be interrupted. A coroutine is cancelled: it
    would wait, or look again and again, for as long as the component lives.
    """
    work = asyncio.ensure_future(awaitable)
    timer = asyncio.ensure_future(host.sleep(seconds))
    try:
        await asyncio.wait({work, timer}, return_when=asyncio.FIRST_COMPLETED)
    finally:
        timer.cancel()
        if asyncio.iscoroutine(awaitable):
            work.cancel()
    if work.done():
        return work
    # Retrieved, so that asyncio does not log the exception of what is no longer awaited.
    work.add_done_callback(lambda ended: ended.cancelled() or ended.exception())
    return None


class FirstDecision:
    """The decision whether something happens (data thread) or is withdrawn (control thread): the first one decides."""

    def __init__(self) -> None:
        self._lock = threading.Lock()  # never released

    def make(self) -> bool:
        """Returns whether the caller is the first."""
        return self._lock.acquire(blocking=False)

    def made(self) -> bool:
        return self._lock.locked()


@dataclass
class DataExecutor:
    """Runs functions on the data thread for the control thread, in bounded time; ``busy`` says what keeps it busy."""

    host: Host
    busy: Callable[[], str]

    async def run(self, function: Callable[[], T], timeout: float, *, late: bool = False) -> T:
        """The result of ``function``, run between two calls of user code.

        Raises CommandRefused where the data thread is not free within ``timeout``; then it runs later if ``late``, and
        else not at all.
        """
        decision = FirstDecision()
        work = asyncio.ensure_future(self.host.on_data(lambda: function() if decision.make() else None))
        if await within(self.host, work, timeout) is None:
            if late or decision.make():
                raise CommandRefused(f"user code did not return within {timeout:.3g} s{self.busy()}")
            if await within(self.host, work, timeout) is None:
                raise CommandRefused(f"it has started, but did not end within another {timeout:.3g} s{self.busy()}")
        result: T = work.result()  # type: ignore[assignment]  # it was not withdrawn, so it has run
        return result

    async def drive(self, function: Callable[[], Any], timeout: float) -> bool:
        """Run user code that may be async. Returns whether it ended within ``timeout``. Raises what it raises."""
        loop = asyncio.get_running_loop()
        ended = asyncio.Event()
        raised: list[BaseException] = []

        async def guarded(coroutine: Coroutine[Any, Any, Any]) -> None:
            try:
                await coroutine
            except CAUGHT as error:
                raised.append(error)

        def on_end() -> None:
            if not loop.is_closed():
                loop.call_soon_threadsafe(ended.set)

        decision = FirstDecision()

        def begin() -> bool:
            if not decision.make():
                return False
            result = function()
            if not asyncio.iscoroutine(result):
                return True
            self.host.run_coroutine(guarded(result), on_end)
            return False

        work = await within(self.host, self.host.on_data(begin), timeout)
        if work is None:
            decision.make()
            return False
        if not work.result() and await within(self.host, ended.wait(), timeout) is None:
            return False
        if raised:
            raise raised[0]
        return True


@dataclass
class Hold:
    """Keeps functionalities between two calls until :meth:`release`, so that their modes can be changed at once.

    ``held`` is called on the data thread as soon as no call of them is under way.
    """

    runners: Sequence[FunctionalityRunner]
    held: Callable[[], object]
    _released: bool = False

    def attempt(self) -> None:
        """On the data thread; an async call that is under way calls it again at its end."""
        if self._released:
            return
        for runner in self.runners:
            runner.block(self.attempt)
        if not any(runner.asynchronous for runner in self.runners):
            self.held()

    def release(self) -> None:
        """On the data thread: calls may start again."""
        self._released = True
        for runner in self.runners:
            runner.unblock(self.attempt)


@dataclass
class ModeSwitch:
    """One mode change of a group of functionalities: all at once, between two calls of each, or not at all.

    ``guard`` is called at that moment; a reason that it returns refuses the change. ``ended`` is called on the data
    thread once the change has happened or is refused, before the new modes' first calls. ``reflex``: the local
    reflex asks for it; ``conditional``: because of a condition. ``hold``: keeps them between two calls, and ends with
    the switch.
    """

    targets: dict[FunctionalityRunner, int]
    because: str
    guard: Callable[[], str | None]
    ended: Callable[[], object]
    reflex: bool = False
    conditional: bool = False
    hold: Hold | None = None
    at: int | None = None  # when the last mode was entered (steady ns)
    before: dict[str, str] = field(default_factory=dict)
    refused: str | None = None
    decision: FirstDecision = field(default_factory=FirstDecision)

    def attempt(self) -> None:
        """On the data thread: switch, unless an async call is under way; then this is called again at its end."""
        if self.decision.made():
            return
        if any(runner.asynchronous for runner in self.targets):
            for runner in self.targets:
                runner.block(self.attempt)
            return
        if not self.decision.make():  # the control thread has just withdrawn it
            return
        try:
            self.refused = self.guard()
            if self.refused is None:
                self._switch()
        except Exception as error:  # ours, or the platform's: the control thread waits for the outcome
            self.refused = f"the change failed half-way: {type(error).__name__}: {error}"
            raise
        finally:
            self.ended()
            self.release()

    def _switch(self) -> None:
        moved = {runner: index for runner, index in self.targets.items() if runner.index != index}
        self.before = {runner.name: runner.mode.name for runner in self.targets}
        for runner, index in moved.items():
            runner.stop_calls()
            runner.enter_mode(index, self.because, reflex=self.reflex, conditional=self.conditional)
            self.at = runner.since
        self.ended()
        for runner in moved:
            runner.start_calls()

    def release(self) -> None:
        """On the data thread, once it has happened or is withdrawn: calls may start again."""
        if self.hold is not None:
            self.hold.release()
        for runner in self.targets:
            runner.unblock(self.attempt)
