"""Probation and watch-after by measured rates: what a new publisher must show before the cut, and keep after it.

docs/protocols/probation.md. Both are off unless the specification states a duration (``timing``), but for the probation
of programs without Midstride's API: these keep their rates themselves, and may be other than what is declared.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Mapping
from typing import Final

from midstride.errors import MidstrideError, StepFailed
from midstride.model.component import PortRef
from midstride.model.specification import handover_seconds
from midstride.runtime.process.component_client import ComponentClient
from midstride.wire.commands import AwaitRateCommand
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
        raise StepFailed(f"{_words(port, rate, window, verdict)}, behind its gate; it was given {timeout:g} s{words}")


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

    watching = [asyncio.ensure_future(watch(*output)) for output in outputs]
    try:
        await asyncio.gather(*watching)
    finally:
        for task in watching:
            task.cancel()
        await asyncio.gather(*watching, return_exceptions=True)


def _words(port: PortRef, rate: float, window: float, verdict: RateVerdict) -> str:
    return (
        f"{port} does not keep the {rate:g} Hz that its mode guarantees: in the last {window:g} s it wrote at "
        f"{verdict.rate:.3g} Hz, with a pause of {verdict.pause:.3g} s"
    )
