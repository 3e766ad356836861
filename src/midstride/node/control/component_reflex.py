"""The local reflex: a functionality whose assumption breaks, or whose call hangs, degrades by itself.

It needs neither the manager nor the network (docs/protocols/reflex.md; the rule is in
:mod:`.shortfall`). The control thread counts what has arrived and what was written, so a call that never returns does
not disable it. The mode itself changes on the data thread, between two calls; where a call of user code prevents that,
the state shows the worse mode at once, and the change follows when the call returns.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Final

from midstride.errors import CommandRefused
from midstride.node.author.client_ports import ABSENT, ClientPort
from midstride.node.author.ports import Input, Output
from midstride.node.author.server_ports import ServerPort
from midstride.node.component_host import Host
from midstride.node.control.shortfall import FLOOR, LONG_FLOOR, Shortfall, Stopwatch, tolerated_periods
from midstride.node.data.functionality_runner import FunctionalityRunner
from midstride.node.data.mode_switch import ModeSwitch

# How often it looks (s), unless a condition changes: a fraction of the shortest silence that is tolerated, within
# these; or while nothing is due.
PART: Final = 0.2
SHORTEST: Final = 0.01
LONGEST: Final = 0.1
IDLE: Final = 0.5
# How long after a condition has changed it looks (s): a message that decides several inputs reaches them one by one.
SETTLING: Final = 0.003
# A data thread that takes longer than that for a change has had no time for messages either (s).
LATE: Final = 0.2


@dataclass(eq=False)
class Fall:
    """A degradation under way; ``attempt`` is for the data thread.

    ``late``: given up, since the data thread was busy. ``shown``: the state shows it.
    """

    switch: ModeSwitch
    attempt: Callable[[], None]
    posted: int
    attempted: bool = False
    late: bool = False
    shown: bool = False

    @property
    def waits(self) -> bool:
        """Return whether the data thread has not come to the fall yet, and nothing shows it."""
        return not (self.attempted or self.shown or self.switch.decision.made())


class Watch:
    """The assumptions and promises of a functionality's current mode, counted since it was entered."""

    def __init__(self, runner: FunctionalityRunner) -> None:
        self.runner = runner
        self.entered = runner.entered
        self.inputs = {port: Shortfall(port.count) for port in runner.inputs}
        self.outputs = {port: Shortfall(port.count) for port in runner.mode.outputs}
        self.fall: Fall | None = None
        # Runs on the data thread as soon as that is free; for how long it has waited (s).
        self.probe: asyncio.Future[None] | None = None
        self.probed = 0.0

    def restart(self) -> None:
        for port, shortfall in self.inputs.items():
            shortfall.restart(port.count)
        for output, shortfall in self.outputs.items():
            shortfall.restart(output.count)

    def advance(self, seconds: float) -> None:
        inputs = self.inputs if self.fall is None else {}  # what keeps a fall waiting keeps messages waiting, too
        for port, shortfall in inputs.items():
            count = port.count
            if count == 0 or port.rate is None:  # it has not been received since it was attached: nothing is lost
                shortfall.restart(count)
            else:
                shortfall.advance(seconds * port.rate, count)
        for output, shortfall in self.outputs.items():
            if output.rate is None or not any(link.lets_pass for link in output.links):
                shortfall.restart(output.count)
            else:
                shortfall.advance(seconds * output.rate, output.count)
        if self.probe is not None:
            self.probed += seconds

    def tolerated(self, port: Input, speed: float) -> float:
        """For how many periods ``port`` may be silent; infinite where it has no rate."""
        if port.rate is None:
            return float("inf")
        lenient = port.tolerates is None or port.recording
        floor = LONG_FLOOR if lenient else FLOOR if self.inputs[port].fresh else 0.0
        return tolerated_periods(port.rate, port.tolerates, floor * speed)

    def due(self, output: Output, speed: float) -> float:
        """For how many periods ``output`` may be silent; infinite where nothing is promised."""
        return float("inf") if output.rate is None else tolerated_periods(output.rate, None, LONG_FLOOR * speed)

    def shortest(self, speed: float) -> float | None:
        """The shortest silence that is tolerated (s of the steady clock); None where nothing is due."""
        if self.runner.index == self.runner.last:
            return None
        found = [self.tolerated(port, speed) / port.rate for port in self.inputs if port.rate is not None]
        found += [self.due(output, speed) / output.rate for output in self.outputs if output.rate is not None]
        found += [ABSENT * speed for port in self.inputs if isinstance(port, ClientPort)]
        return min(found) / speed if found else None

    # -- assumptions -------------------------------------------------------------------------------------

    def broken_assumption(self, speed: float) -> list[Input]:
        """The inputs of the first assumption of the mode that does not hold any more; none if all do."""
        for group in self.runner.mode.assumptions:
            broken = [port for port in group if self._broken(port, speed)]
            if broken and all(port in broken or not port.count for port in group):
                return broken
        return []

    def _broken(self, port: Input, speed: float, share: float = 1.0) -> bool:
        """Return whether the condition of ``port`` does not hold, or it lacks more than that share of what is
        tolerated.
        """
        shortfall = self.inputs[port]
        if shortfall.in_order:  # in most cases, and then what is tolerated need not be known
            return port.denied
        periods = share * self.tolerated(port, speed)
        return port.denied or shortfall.exceeds(periods, slow=port.tolerates is not None)

    def why(self, port: Input, speed: float) -> str:
        """The reason why ``port`` is broken, in words."""
        if isinstance(port, ClientPort) and port.gone is not None:
            return port.gone
        rate, topics = port.rate, ", ".join(link.topic for link in port.links)
        if port.denied:
            return f"condition {port.name} does not hold on {topics}: {'; '.join(port.violations)}"
        assert rate is not None
        came, seconds = self.inputs[port].words(rate)
        tolerated = f"silence is tolerated for {self.tolerated(port, speed) / rate:.2g} s"
        gone = "" if any(link.endpoint.matched() for link in port.links) else ", and its publisher is gone"
        wrong = f" that meets its constraints ({'; '.join(port.violations)})" if port.violations else ""
        received = f"input {port.name} received {came}{wrong} on {topics} for {seconds:.2f} s{gone}"
        return f"{received} ({rate:g} Hz is assumed; {tolerated})"

    def next_mode(self, speed: float) -> int:
        """The best mode below the current one whose inputs are known to be in order, at last the degraded mode.

        An input without a rate is as good as it was, where the current mode relies on it too.
        """
        relied = {port for group in self.runner.mode.assumptions for port in group}

        def in_order(port: Input) -> bool:
            if port.denied:
                return False
            if isinstance(port, ClientPort):
                return port.ready
            if port.rate is None:
                return port.attached and (port in relied or (port.condition and port.count > 0))
            return port.count > 0 and not self._broken(port, speed, 0.5)

        for index in range(self.runner.index + 1, self.runner.last):
            if all(any(map(in_order, group)) for group in self.runner.chain[index].assumptions):
                return index
        return self.runner.last

    def silent_output(self, speed: float, share: float) -> Output | None:
        """An output on which nothing was written for more than that share of what is tolerated."""
        for port, shortfall in self.outputs.items():
            if shortfall.silent and shortfall.silent > share * self.due(port, speed):
                return port
        return None


@dataclass
class Reflex:
    """Watches the functionalities of a component, on the control thread.

    ``commanded``: whether a command of the manager is being carried out, which may keep the data thread busy.
    ``degraded`` is called once a functionality has degraded, or its state shows so; on either thread.
    ``condition_changed`` is called on the control thread when a condition has begun or ceased to hold. ``before`` is
    awaited before a functionality enters a mode, by name; where it raises CommandRefused, the last mode is entered
    instead.
    """

    host: Host
    runners: Sequence[FunctionalityRunner]
    commanded: Callable[[], bool]
    degraded: Callable[[FunctionalityRunner], None]
    condition_changed: Callable[[], None]
    before: Callable[[Mapping[str, str]], Awaitable[None]] | None = None
    _watches: dict[FunctionalityRunner, Watch] = field(default_factory=dict)
    _changed: asyncio.Event = field(default_factory=asyncio.Event)

    async def run(self) -> None:
        stopwatch, pause = Stopwatch(self.host), IDLE
        wake = partial(asyncio.get_running_loop().call_soon_threadsafe, self._changed.set)
        for port in {port for runner in self.runners for port in runner.inputs}:
            port.condition_changed = wake
        while True:
            changed = await self._pause(pause)
            seconds, speed = stopwatch.lap(pause), stopwatch.speed
            watches = self._look(None if stopwatch.grace else seconds, speed)
            shortest = [found for watch in watches if (found := watch.shortest(speed)) is not None]
            pause = min(LONGEST, max(SHORTEST, PART * min(shortest))) if shortest else IDLE
            if changed:
                self.condition_changed()

    async def _pause(self, seconds: float) -> bool:
        """Wait for so long, or until a condition changes; whether one did."""
        if not any(port.condition for runner in self.runners for port in runner.inputs):
            await self.host.sleep(seconds)
            return False
        waits = [asyncio.ensure_future(each) for each in (self._changed.wait(), self.host.sleep(min(seconds, LONGEST)))]
        try:
            await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for each in waits:
                each.cancel()
        if changed := self._changed.is_set():
            await self.host.sleep(SETTLING)
            self._changed.clear()
        return changed

    def _look(self, seconds: float | None, speed: float) -> Iterator[Watch]:
        """``seconds`` have gone by; None: the process has been stopped, and what is lacking now says nothing."""
        for client in {port for runner in self.runners for port in runner.inputs if isinstance(port, ClientPort)}:
            if seconds is None:
                client.pardon()
            client.look()
        for server in {port for runner in self.runners for port in runner.outputs if isinstance(port, ServerPort)}:
            server.look(self.host)
        for runner in self.runners:
            watch = self._watches.get(runner)
            if watch is None or watch.entered != runner.entered:
                for port in runner.inputs:
                    if isinstance(port, ClientPort):
                        port.restart()
                watch = self._watches[runner] = Watch(runner)
                if any(port.denied for port in watch.inputs) and runner.index < runner.last and not runner.switching:
                    self._judge(watch, speed)  # what counts messages begins with the mode; a condition does not
            elif watch.fall is not None and not watch.fall.waits:
                self._follow(watch, watch.fall)
            elif seconds is None:
                watch.restart()
            else:
                watch.advance(seconds)
                if runner.index < runner.last and not runner.switching:
                    self._judge(watch, speed)
            yield watch

    def _judge(self, watch: Watch, speed: float) -> None:
        runner, waiting = watch.runner, watch.fall
        if waiting is None and (broken := watch.broken_assumption(speed)):
            reason = "; ".join(watch.why(port, speed) for port in broken)
            words = f"the assumption of mode {runner.mode.name} broke: {reason}"
            # What another fault has degraded before is not restored at once because a condition holds again.
            denied = all(port.denied and not isinstance(port, ClientPort) for port in broken)
            conditional = denied and (runner.conditional or not runner.reflex)
            self._fall(watch, watch.next_mode(speed), words, conditional=conditional)
        elif (hang := self._hang(watch, speed)) is not None and (waiting is None or self._withdraw(waiting)):
            fall = self._fall(watch, runner.last, hang, hangs=True)
            self._show(runner, fall)

    def _hang(self, watch: Watch, speed: float) -> str | None:
        """The reason why a promised output is silent, where a call of user code is the cause.

        A mode whose calls return without a write is no hang: the manager's status shows it, and the readers notice.
        """
        runner = watch.runner
        if self.commanded() or watch.silent_output(speed, 0.5) is None:
            watch.probe = None
            return None
        if watch.probe is None:
            watch.probe, watch.probed = asyncio.ensure_future(self.host.on_data(lambda: None)), 0.0
        output = watch.silent_output(speed, 1.0)
        if output is None:
            return None
        if watch.probe.done():
            watch.probe = None
            if not runner.asynchronous:
                watch.outputs[output].restart(output.count)
                return None
        elif watch.probed < 0.4 * FLOOR * speed:
            return None
        rate, busy = output.rate, self._busy_words(runner)
        assert rate is not None
        wrote, seconds = watch.outputs[output].words(rate)
        mode = f"mode {runner.mode.name} wrote {wrote} on output {output.name}"
        return f"{mode} for {seconds:.2f} s instead of {rate:g} Hz: {busy}"

    def _busy_words(self, runner: FunctionalityRunner) -> str:
        for other in (runner, *self.runners):
            if other.busy is not None and (other is runner or not other.asynchronous):
                seconds = (self.host.steady() - other.busy) / 1e9
                return f"a call of {other.name} has not returned for {seconds:.2f} s"
        return "user code occupies its thread"

    def _fall(self, watch: Watch, index: int, because: str, hangs: bool = False, conditional: bool = False) -> Fall:
        """Have the data thread change the mode, unless it has been entered anew by then."""
        runner, steady = watch.runner, self.host.steady

        def guard() -> str | None:
            return None if runner.entered == watch.entered else "its mode has changed meanwhile"

        def ended() -> None:
            index = fall.switch.targets[runner]
            if runner.index == index and runner.because == fall.switch.because and not fall.shown:
                fall.shown = True
                self.degraded(runner)

        def attempt() -> None:
            fall.late = not hangs and steady() - fall.posted > LATE * 1e9
            if not fall.late:
                fall.switch.attempt()
            fall.attempted = True

        switch = ModeSwitch({runner: index}, because, guard, ended, reflex=True, conditional=conditional)
        fall = watch.fall = Fall(switch, attempt, steady())
        self._post(fall)
        return fall

    def _withdraw(self, fall: Fall) -> bool:
        """Return whether ``fall`` has not happened, and will not."""
        withdrawn = fall.switch.decision.make()
        if withdrawn:
            self.host.on_data(fall.switch.release)
        return withdrawn

    def _post(self, fall: Fall) -> None:
        fall.attempted = False
        attempt = self.host.on_data(fall.attempt) if self.before is None else self._prepared(fall, self.before)
        asyncio.ensure_future(attempt).add_done_callback(self._log_failure)

    async def _prepared(self, fall: Fall, before: Callable[[Mapping[str, str]], Awaitable[None]]) -> None:
        """Attempt ``fall`` once what must come before it is done."""
        switch = fall.switch
        try:
            await before({runner.name: runner.chain[index].name for runner, index in switch.targets.items()})
        except CommandRefused as error:
            switch.because = f"{switch.because}; {error}"
            switch.targets = {runner: runner.last for runner in switch.targets}
            with contextlib.suppress(CommandRefused):  # its gate closes all the same
                await before({runner.name: runner.chain[runner.last].name for runner in switch.targets})
        fall.posted = self.host.steady()
        await self.host.on_data(fall.attempt)

    def _follow(self, watch: Watch, fall: Fall) -> None:
        if fall.late:  # messages may be waiting behind the call that kept the data thread
            watch.fall = None
            for shortfall in watch.inputs.values():
                shortfall.halve()
        elif fall.switch.decision.made():
            watch.fall = None
        elif fall.attempted:  # an asynchronous call is under way
            if not fall.shown:
                self._show(watch.runner, fall)
            if not watch.runner.switching:  # the manager has requested another mode, and withdrawn that
                self._post(fall)

    def _show(self, runner: FunctionalityRunner, fall: Fall) -> None:
        fall.shown = True
        runner.falling = (fall.switch.targets[runner], fall.switch.because)
        self.degraded(runner)

    def _log_failure(self, work: asyncio.Future[None]) -> None:
        if not work.cancelled() and (error := work.exception()) is not None:
            self.host.logger.error(f"degrading failed: {type(error).__name__}: {error}")
