"""Probation and watch-after by measured rates: what a new publisher must show before the cut, and keep after it.

docs/semantics.md section 7. Both are off unless the specification states a duration (``timing``).
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Mapping
from typing import Final

from midstride.errors import MidstrideError, StepFailed
from midstride.model.component import PortRef
from midstride.model.specification import handover_seconds
from midstride.runtime.component_client import ComponentClient
from midstride.wire.commands import AwaitRateCommand, RateVerdict

# A rate is not judged over less than so many periods, nor watched after a cut over less than so long (s).
SHORTEST_PERIODS: Final = 5
WATCHED_WINDOW: Final = 1.0


async def require_rate(
    client: ComponentClient, port: PortRef, topic: str, rate: float, timing: Mapping[str, float], stretch: float
) -> None:
    """Wait until ``port`` has kept ``rate`` (Hz) behind its gate for the probation that ``timing`` states.

    ``stretch`` is how long a second of its clock takes. Raises StepFailed if it has not within the time-out.
    """
    stated = handover_seconds(timing, "probation")
    if not stated:
        return
    window = max(stated, SHORTEST_PERIODS / rate)
    timeout = (window + handover_seconds(timing, "probation_timeout")) * stretch
    command = AwaitRateCommand(port=port.port, topic=topic, rate=rate, window=window, until="met", timeout=timeout)
    verdict = await client.read(port.instance, command)
    if verdict.failed:
        raise StepFailed(f"the code that writes {port} has raised behind its gate")
    if not verdict.reached:
        raise StepFailed(f"{_words(port, rate, window, verdict)}, behind its gate; it was given {timeout:g} s")


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
