"""Probation and watch-after by measured rates: what a new publisher must show before the cut, and keep after it.

docs/protocols/probation.md. How long both take, the specification states (``timing``), or a default applies.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final, Literal, NamedTuple, TypeAlias

from msgspec import structs

from midstride.errors import MidstrideError, StepFailed
from midstride.model.action import Swap
from midstride.model.component import PortRef
from midstride.model.specification import FEWEST_PERIODS, handover_seconds, probation_seconds
from midstride.runtime.cancellation import all_of
from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.watch.simulated_time import stretch_of
from midstride.wire.commands import AwaitRateCommand, AwaitWriteCommand, CountWritesCommand
from midstride.wire.replies import RateVerdict
from midstride.wire.state import MeasuredResponses, duration_in_words

# A rate is not watched after a cut over less than so long (s).
WATCHED_WINDOW: Final = 1.0
# How much of what its predecessor writes a new publisher must write where that does not keep the rate either; and how
# much of the rate, less one message, the predecessor must write to have kept it.
AS_MUCH: Final = 0.9
# How often it is looked whether the old side has exited (s).
INTERVAL: Final = 0.02
# How long the new component may take to write once behind its gate (s), on top of 10 of its periods.
PROBATION: Final = 5.0
# From how many calls its code must have returned behind the gate, as far as they come within so many seconds of its
# first message: what raises at once in most cases is rejected, and a slow component costs no time.
CALLS: Final = 3
CALLS_PATIENCE: Final = 0.5
# An output is quiet if neither side has written anything for so long (s), and for as long as its rate is judged. The
# two sides are compared over no less: in a few periods, a busy computer makes any publisher look slow.
QUIET: Final = 1.0
# A new publisher that keeps no rate is let in once the old one has not kept it either for so long (s), window after
# window.
SLOW: Final = 2.0

# How often it is looked what a server has answered (s).
SERVER_LOOK: Final = 0.2
# A server breaks its bound by fewer of its responses within it, or by a request that waits for more than so many
# bounds, and at least so long (s): as an output breaks its rate.
BROKEN_SHARE: Final = 0.8
BROKEN_PERIODS: Final = 10.0
BROKEN_PAUSE: Final = 1.0

Passed: TypeAlias = Literal["writes", "quiet"]


@dataclass(slots=True)
class Probation:
    """The probation of the new publisher of ``swap`` behind its gate; ``rate`` is its guarantee (Hz), 0 where it has
    none.

    ``latched``: late subscribers get its last message. ``timing`` is that of the specification; ``rates``: whether it
    must keep its rate. ``waits_for`` says what a component waits for, as the end of a sentence.
    """

    client: ComponentClient
    swap: Swap
    topic: str
    rate: float
    latched: bool
    timing: Mapping[str, float]
    waits_for: Callable[[str], Awaitable[str]]
    rates: bool = True
    _stretch: float = field(init=False)  # how long a second of the old one's clock takes (s)
    _window: float = field(init=False)  # over how long its rate is judged (s), 0 if it is not
    _lost: str = field(default="", init=False)  # what would be lost if it took over without a message
    _beside: str = field(default="", init=False)  # what the old one wrote meanwhile

    def __post_init__(self) -> None:
        self._stretch = stretch_of(self.client, self.swap.old.instance)
        self._window = probation_seconds(self.timing, self.rate) if self.rates else 0.0

    async def run(self) -> Passed:
        """Wait until it has passed: it writes as it should, or no less than the old one, or neither writes at all.

        Raises StepFailed with what it lacks.
        """
        first = asyncio.ensure_future(self._write())
        kept = asyncio.ensure_future(self._keep_rate(first))
        beside = asyncio.ensure_future(self._compare())
        try:
            await asyncio.wait({kept, beside}, return_when=asyncio.FIRST_COMPLETED)
            passed = None if kept.done() else beside.result()
            if passed == "quiet":
                return passed
            await (kept if passed is None else first)
            return "writes"
        finally:
            for task in (first, kept, beside):
                task.cancel()
            await asyncio.gather(first, kept, beside, return_exceptions=True)

    async def _write(self) -> None:
        """Wait for its first messages behind the gate. Raises StepFailed."""
        new, rate = self.swap.new, self.rate
        timeout = PROBATION + (10 / rate * self._stretch if rate else 0.0)
        # Without a rate, messages drive it, or it is called once.
        calls = min(CALLS, 1 + int(rate / self._stretch * CALLS_PATIENCE)) if rate else 1
        await_write = AwaitWriteCommand(
            port=new.port, topic=self.topic, calls=calls, patience=CALLS_PATIENCE, timeout=timeout
        )
        seen = await self.client.read(new.instance, await_write)
        if seen.wrong_type:
            raise StepFailed(f"{new} wrote a message of the wrong type behind its gate: {seen.wrong_type}")
        if seen.failed:
            raise StepFailed(f"the code that writes {new} has raised behind its gate")
        if not seen.gated:
            because = await self.waits_for(new.instance)
            raise StepFailed(
                f"{new} has written nothing within {timeout:.3g} s, so it cannot take over{self._beside}"
                f"{because}{self._lost}"
            )

    async def _keep_rate(self, first: Awaitable[None]) -> None:
        """Wait until it has kept its rate for the window. Raises StepFailed if it has not within the time-out.

        By default, it is not waited for where the old side has exited: the topic is silent.
        """
        await first
        if not self._window:
            return
        by_default, timeout = "probation" not in self.timing, handover_seconds(self.timing, "probation_timeout")
        command = AwaitRateCommand(
            port=self.swap.new.port,
            topic=self.topic,
            rate=self.rate,
            window=self._window,
            until="met",
            timeout=(self._window + timeout) * self._stretch,
            known_clock=by_default,
        )
        judging = asyncio.ensure_future(self.client.read(self.swap.new.instance, command))
        try:
            while not judging.done():
                if by_default and self.client.life.is_gone(self.swap.old.instance):
                    return
                await asyncio.wait({judging}, timeout=INTERVAL)
            verdict = judging.result()
        finally:
            judging.cancel()
        if verdict.failed:
            raise StepFailed(f"the code that writes {self.swap.new} has raised behind its gate")
        if not verdict.reached:
            words = "; `timing { probation 0 s }` in the specification lets it in all the same" if by_default else ""
            raise StepFailed(
                f"{_words(self.swap.new, self.rate, self._window, verdict)}, behind its gate{self._beside}; "
                f"it was given {command.timeout:.3g} s{words}"
            )

    async def _compare(self) -> Passed | None:
        """Wait until neither side writes, or the old one does not keep the rate and the new one writes no less.

        None if the old one has exited, or what it has written last would be lost. Where one of them does not answer in
        time, nothing is known of that while.
        """
        judged = max(self._window or (FEWEST_PERIODS / self.rate if self.rate else 0.0), QUIET)
        silent = slow = 0.0
        before: tuple[int, int] | None = None
        while True:
            try:
                written: tuple[int, int] | None = await self._written()
            except MidstrideError:
                written = None
            if self.client.life.is_gone(self.swap.old.instance):
                return None
            if before is None or written is None:
                silent = slow = 0.0
            else:
                old, new = (now - earlier for now, earlier in zip(written, before, strict=True))
                silent = 0.0 if old or new else silent + judged
                if silent >= QUIET:
                    return "quiet" if self._loses_nothing(*written) else None
                self._beside = f" ({self.swap.old} wrote at {old / judged:.3g} Hz in that time)"
                as_slow = new >= max(1, AS_MUCH * old) and old < AS_MUCH * self.rate * judged - 1
                slow = slow + judged if as_slow else 0.0
                if self._window and slow >= SLOW:
                    return "writes"
            before = written
            await self.client.clock.sleep(judged * self._stretch)

    def _loses_nothing(self, old: int, new: int) -> bool:
        """Return whether the new side may take over without a message; ``old`` and ``new`` are how many the sides have
        ever written.

        Of an output whose last message late subscribers get, the new side needs one where the old side has one, unless
        the specification states that nothing is waited for.
        """
        if self.latched and old and not new and self.timing.get("probation") != 0:
            self._lost = (
                f"; subscribers that join later would not get the last message of {self.swap.old} any more; "
                "`timing { probation 0 s }` in the specification lets it in all the same"
            )
            return False
        return True

    async def _written(self) -> tuple[int, int]:
        """The numbers of messages that the old side and the new one have written."""
        old, new = await all_of(
            self.client.read(port.instance, CountWritesCommand(port=port.port, topic=self.topic))
            for port in (self.swap.old, self.swap.new)
        )
        return old.written, new.written


class WatchedOutput(NamedTuple):
    """A publisher that is watched: the output, that of its predecessor, if any, the topic, and its rate (Hz), or 0."""

    port: PortRef
    old: PortRef | None
    topic: str
    rate: float


async def watch_after(
    client: ComponentClient,
    outputs: Iterable[WatchedOutput],
    seconds: float,
    stretch: float,
    shortest: float = WATCHED_WINDOW,
) -> None:
    """Watch publishers for ``seconds``, their rates over ``shortest`` seconds, or five periods.

    Raises StepFailed as soon as one of them does not keep its rate, unless its predecessor, behind its gate, writes no
    more, or raises, or does not answer any more.
    """

    def after(output: WatchedOutput) -> str:
        return "after its parameters were set" if output.old is None else "after the hand-over"

    async def written(output: WatchedOutput) -> tuple[float, float]:
        """The numbers of messages that the new one and the old one have written; none of an old one that has ended."""
        command = CountWritesCommand(port=output.port.port, topic=output.topic)
        new = (await client.read(output.port.instance, command)).written
        if output.old is None:
            return new, math.nan
        try:
            old = await client.read(output.old.instance, structs.replace(command, port=output.old.port))
        except MidstrideError:
            return new, math.nan
        return new, old.written

    async def watch(output: WatchedOutput) -> None:
        port, rate, left = output.port, output.rate, seconds * stretch
        window = max(shortest, FEWEST_PERIODS / rate if rate else 0.0)
        try:
            while left > 0:
                command = AwaitRateCommand(
                    port=port.port, topic=output.topic, rate=rate, window=window, until="broken", timeout=left
                )
                begun, before = client.clock.steady(), await written(output) if rate else (0, 0)
                verdict = await client.read(port.instance, command)
                if verdict.failed:
                    raise StepFailed(f"the code that writes {port} has raised {after(output)}")
                if not verdict.reached:
                    return
                new, old = (now - earlier for now, earlier in zip(await written(output), before, strict=True))
                if not new >= AS_MUCH * old - 1:
                    raise StepFailed(f"{_words(port, rate, window, verdict)}, {after(output)}")
                left -= client.clock.steady() - begun
        except StepFailed:
            raise
        except MidstrideError as error:
            raise StepFailed(f"{port} was watched {after(output)}: {error}") from error

    await all_of(watch(output) for output in outputs)


class WatchedServer(NamedTuple):
    """A server that is watched: its port, and the name of its service or ROS action."""

    port: PortRef
    name: str


async def watch_servers_after(client: ComponentClient, servers: Iterable[WatchedServer], seconds: float) -> None:
    """Watch servers with a bound for ``seconds``, by what is reported of them; nothing is judged without a request.

    As with a rate, the bound is broken by fewer than eight tenths of the responses in it, or by a request that waits
    for more than ten bounds and 1 s. Raises StepFailed as soon as one of them breaks it, or has exited.
    """

    def seen(server: WatchedServer) -> MeasuredResponses | None:
        state = client.life.responsive(server.port.instance)
        if state is None:
            raise StepFailed(f"{server.port.instance} does not answer, or has exited, after the hand-over")
        link = state.ports.get(server.port.port, {}).get(server.name)
        return None if link is None else link.responses

    async def watch(server: WatchedServer) -> None:
        before, deadline = seen(server), client.clock.steady() + seconds
        while (left := deadline - client.clock.steady()) > 0:
            await client.clock.sleep(min(left, SERVER_LOOK))
            now = seen(server)
            if now is None:
                continue
            answered, late = now.answered, now.late
            if before is not None and before.answered <= answered:
                answered, late = answered - before.answered, late - before.late
            if now.silent > max(BROKEN_PERIODS * now.within, BROKEN_PAUSE):
                words = f"has not answered for {duration_in_words(now.silent)}"
            elif answered >= FEWEST_PERIODS and late > (1 - BROKEN_SHARE) * answered + 1:
                longest = "" if now.longest is None else f" (in up to {duration_in_words(now.longest)})"
                words = f"has answered {late} of {answered} requests late{longest}"
            else:
                continue
            raise StepFailed(f"{server.port} {words} on {server.name} after the hand-over: {now.promised}")

    await all_of(watch(server) for server in servers)


def _words(port: PortRef, rate: float, window: float, verdict: RateVerdict) -> str:
    return (
        f"{port} does not keep the {rate:g} Hz that its mode guarantees: in the last {window:.3g} s it wrote at "
        f"{verdict.rate:.3g} Hz, with a pause of {verdict.pause:.3g} s"
    )
