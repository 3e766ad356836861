"""Measurements as the stream shows them: rounded, and the same as before until they have changed noticeably.

So a system in which nothing happens sends next to nothing, although no two measurements are equal.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from midstride.runtime.records.status_forms import PortStatus
from midstride.wire.state import Measured

# By which share of the shown value, and by how much, a measurement must differ from it to be refreshed.
_RATE: Final = (0.01, 0.0)
_AGE: Final = (0.5, 1.0)
_TIMES: Final = (0.25, 0.002)


class Measurements(NamedTuple):
    """Of one attachment: the rate in Hz, times in seconds; None where nothing is known."""

    rate: float | None = None
    age: float | None = None
    jitter: float | None = None
    longest: float | None = None

    @classmethod
    def of(cls, measured: Measured) -> Measurements:
        """The measurements, not rounded."""
        return cls(measured.rate, measured.age, measured.jitter, measured.longest)


NOTHING_MEASURED: Final = Measurements()


def rounded(measured: Measured | None, shown: Measurements = NOTHING_MEASURED) -> Measurements:
    """The measurements of an attachment to show, where ``shown`` is shown of it."""
    if measured is None:
        return NOTHING_MEASURED
    return Measurements(
        _refreshed(shown.rate, measured.rate, *_RATE),
        _refreshed(shown.age, measured.age, *_AGE),
        _refreshed(shown.jitter, measured.jitter, *_TIMES),
        _refreshed(shown.longest, measured.longest, *_TIMES),
    )


def differ_noticeably(shown: Measurements | PortStatus, measured: Measured | None) -> bool:
    """Return whether :func:`rounded` gives others than those ``shown``. Called for every port, so it must be cheap."""
    if measured is None:
        return (shown.rate, shown.age, shown.jitter, shown.longest) != NOTHING_MEASURED
    return not (
        _stays(shown.rate, measured.rate, *_RATE)
        and _stays(shown.age, measured.age, *_AGE)
        and _stays(shown.jitter, measured.jitter, *_TIMES)
        and _stays(shown.longest, measured.longest, *_TIMES)
    )


def _refreshed(shown: float | None, value: float | None, share: float, least: float) -> float | None:
    if value is None:
        return None
    return shown if _stays(shown, value, share, least) else _three_digits(value)


def _stays(shown: float | None, value: float | None, share: float, least: float) -> bool:
    if value is None or shown is None or value == shown:
        return value == shown
    # A zero is not rounded up to what was there before: it may mean that nothing comes any more.
    return abs(value - shown) <= max(share * shown, least) and (value > 0) == (shown > 0)


def _three_digits(value: float) -> float:
    return value if value == 0 or not math.isfinite(value) else round(value, 2 - math.floor(math.log10(abs(value))))
