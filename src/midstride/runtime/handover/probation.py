"""Probation and watch-after by measured rates: what a new publisher must show before the cut, and keep after it.

docs/protocols/probation.md. Both are off unless the specification states a duration (``timing``), but for the probation
of programs without Midstride's API: these keep their rates themselves, and may be other than what is declared.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final, Literal, TypeAlias

from midstride.errors import MidstrideError, StepFailed
from midstride.model.action import Swap
from midstride.model.component import PortRef
from midstride.model.configuration import Configuration
from midstride.model.specification import handover_seconds
from midstride.runtime.cancellation import all_of
from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.watch.simulated_time import stretch_of
from midstride.wire.commands import AwaitRateCommand, AwaitWriteCommand, CountWritesCommand
from midstride.wire.replies import RateVerdict

# A rate is not judged over less than so many periods, nor watched after a cut over less than so long (s).
SHORTEST_PERIODS: Final = 5
WATCHED_WINDOW: Final = 1.0
# Where no probation is stated, a program without Midstride's API is judged over so many periods, within bounds (s).
DEFAULT_PERIODS: Final = 10
SHORTEST_WINDOW: Final = 0.2
LONGEST_WINDOW: Final = 2.0


def default_probation(rate: float) -> float:
    """Over how long (s) a program without Midstride's API must keep ``rate`` (Hz); 0 if that would take too long."""
    window = min(max(SHORTEST_WINDOW, DEFAULT_PERIODS / rate), LONGEST_WINDOW)
    return window if window >= SHORTEST_PERIODS / rate else 0.0


async def require_rate(
    client: ComponentClient,
    port: PortRef,
    topic: str,
    rate: float,
    timing: Mapping[str, float],
    stretch: float,
    foreign: bool = False,
) -> None:
    """Wait until ``port`` has kept ``rate`` (Hz) behind its gate for the probation that ``timing`` states.

    ``stretch`` is how long a second of its clock takes; ``foreign``: the program does not use Midstride's API.
    Raises StepFailed if it has not within the time-out.
    """
    by_default = foreign and "probation" not in timing
    probation = default_probation(rate) if by_default else handover_seconds(timing, "probation")
    if not probation:
        return
    window = max(probation, SHORTEST_PERIODS / rate)
    timeout = (window + handover_seconds(timing, "probation_timeout")) * stretch
    command = AwaitRateCommand(
        port=port.port, topic=topic, rate=rate, window=window, until="met", timeout=timeout, known_clock=by_default
    )
    verdict = await client.read(port.instance, command)
    if verdict.failed:
        raise StepFailed(f"the code that writes {port} has raised behind its gate")
    if not verdict.reached:
        words = "; `timing { probation 0 s }` in the specification lets it in all the same" if by_default else ""
        raise StepFailed(f"{_words(port, rate, window, verdict)}, behind its gate; it was given {timeout:.3g} s{words}")


# How long the new component may take to write once behind its gate (s), on top of 10 of its periods.
PROBATION: Final = 5.0
# From how many calls its code must have returned behind the gate, as far as they come within so many seconds of its
# first message: what raises at once in most cases is not let in, and a slow component costs no time.
CALLS: Final = 3
CALLS_PATIENCE: Final = 0.5
# An output is quiet if neither side has written anything for so long (s), and for as long as its rate is judged.
QUIET: Final = 1.0

Passed: TypeAlias = Literal["writes", "quiet"]


@dataclass(slots=True)
class Probation:
    """What the new publisher of ``swap`` shows behind its gate.

    ``timing`` is that of the specification; ``waits_for`` says what a component waits for, as the end of a sentence.
    """

    client: ComponentClient
    configuration: Configuration
    timing: Mapping[str, float]
    swap: Swap
    waits_for: Callable[[str], Awaitable[str]]
    _rate: float = field(init=False)  # what the new one guarantees (Hz), or 0
    _stretch: float = field(init=False)  # how long a second of the old one's clock takes (s)
    _lost: str = field(default="", init=False)  # what would be lost if it took over without a message

    def __post_init__(self) -> None:
        self._rate = self.configuration.rate(self.swap.new) or 0.0
        self._stretch = stretch_of(self.client, self.swap.old.instance)

    async def run(self) -> Passed:
        """Wait until it has passed: it writes as it should, or neither side writes at all.

        Raises StepFailed with what it lacks.
        """
        writing, silent = asyncio.ensure_future(self._write()), asyncio.ensure_future(self._fall_silent())
        try:
            await asyncio.wait({writing, silent}, return_when=asyncio.FIRST_COMPLETED)
            if not writing.done() and silent.result():
                return "quiet"
            await writing
            return "writes"
        finally:
            for task in (writing, silent):
                task.cancel()
            await asyncio.gather(writing, silent, return_exceptions=True)

    async def _write(self) -> None:
        """Wait for messages behind the gate, and then for their rate. Raises StepFailed."""
        new, rate = self.swap.new, self._rate
        timeout = PROBATION + (10 / rate * self._stretch if rate else 0.0)
        # Without a rate, messages drive it, or it is called once.
        calls = min(CALLS, 1 + int(rate / self._stretch * CALLS_PATIENCE)) if rate else 1
        await_write = AwaitWriteCommand(
            port=new.port, topic=self._topic, calls=calls, patience=CALLS_PATIENCE, timeout=timeout
        )
        seen = await self.client.read(new.instance, await_write)
        if seen.wrong_type:
            raise StepFailed(f"{new} wrote a message of the wrong type behind its gate: {seen.wrong_type}")
        if seen.failed:
            raise StepFailed(f"the code that writes {new} has raised behind its gate")
        if not seen.gated:
            because = await self.waits_for(new.instance)
            raise StepFailed(
                f"{new} has written nothing within {timeout:.3g} s, so it cannot take over{because}{self._lost}"
            )
        if rate:
            foreign = self.configuration.component(new.instance).gate is not None
            await require_rate(self.client, new, self._topic, rate, self.timing, self._stretch, foreign)

    async def _fall_silent(self) -> bool:
        """Wait until neither side has written for long enough; False if that is not to be known, or not enough.

        Of an output whose last message late subscribers get, the new side needs one where the old side has one, unless
        the specification states that nothing is waited for.
        """
        window = max(QUIET, SHORTEST_PERIODS / self._rate if self._rate else 0.0) * self._stretch
        try:
            before = await self._written()
            await self.client.clock.sleep(window)
            while (written := await self._written()) != before:
                before = written
                await self.client.clock.sleep(window)
        except MidstrideError:
            return False
        old, new = written
        if self._is_latched and old and not new and self.timing.get("probation") != 0:
            self._lost = (
                f"; subscribers that join later would not get the last message of {self.swap.old} any more; "
                "`timing { probation 0 s }` in the specification lets it in all the same"
            )
            return False
        return not self.client.life.is_gone(self.swap.old.instance)

    async def _written(self) -> tuple[int, int]:
        """How many messages the old side and the new one have written."""
        old, new = await all_of(
            self.client.read(port.instance, CountWritesCommand(port=port.port, topic=self._topic))
            for port in (self.swap.old, self.swap.new)
        )
        return old.written, new.written

    @property
    def _is_latched(self) -> bool:
        endpoint = self.configuration.component(self.swap.new.instance).output_endpoint(self.swap.new.port)
        return endpoint is not None and endpoint[1].is_transient_local

    @property
    def _topic(self) -> str:
        return self.configuration.topic(self.swap.connector)


async def watch_after(
    client: ComponentClient, outputs: Iterable[tuple[PortRef, str, float]], seconds: float, stretch: float
) -> None:
    """Watch new publishers, as (port, topic, rate in Hz or 0), for ``seconds`` after their cut.

    Raises StepFailed as soon as one of them does not keep its rate, raises, or does not answer any more.
    """

    async def watch(port: PortRef, topic: str, rate: float) -> None:
        window = max(WATCHED_WINDOW, SHORTEST_PERIODS / rate if rate else 0.0)
        command = AwaitRateCommand(
            port=port.port, topic=topic, rate=rate, window=window, until="broken", timeout=seconds * stretch
        )
        try:
            verdict = await client.read(port.instance, command)
        except MidstrideError as error:
            raise StepFailed(f"{port} was watched after the hand-over: {error}") from error
        if verdict.failed:
            raise StepFailed(f"the code that writes {port} has raised after the hand-over")
        if verdict.reached:
            raise StepFailed(f"{_words(port, rate, window, verdict)}, after the hand-over")

    await all_of(watch(*output) for output in outputs)


def _words(port: PortRef, rate: float, window: float, verdict: RateVerdict) -> str:
    return (
        f"{port} does not keep the {rate:g} Hz that its mode guarantees: in the last {window:.3g} s it wrote at "
        f"{verdict.rate:.3g} Hz, with a pause of {verdict.pause:.3g} s"
    )
