"""What the stream shows of a measurement, and when it shows another one."""

from __future__ import annotations

import math

import pytest

from midstride.runtime.view.rounded_measurements import NOTHING_MEASURED, Measurements, differ_noticeably, rounded
from midstride.wire.state import Measured

SHOWN = Measurements(rate=10.0, age=4.0, jitter=0.1, longest=0.2)


def measured(rate: float | None, age: float | None, jitter: float | None, longest: float | None) -> Measured:
    return Measured(rate=rate, age=age, jitter=jitter, longest=longest, window=2.0)


@pytest.mark.parametrize(
    ("name", "value", "shown"),
    [
        ("rate", 10.09, 10.0),  # less than 1 %
        ("rate", 10.11, 10.1),
        ("rate", 9.91, 10.0),
        ("rate", 9.89, 9.89),
        ("age", 5.99, 4.0),  # half of it
        ("age", 6.01, 6.01),
        ("age", 2.01, 4.0),
        ("age", 1.99, 1.99),
        ("jitter", 0.124, 0.1),  # a quarter of it
        ("jitter", 0.126, 0.126),
        ("longest", 0.249, 0.2),
        ("longest", 0.251, 0.251),
        ("rate", 0.0, 0.0),  # nothing comes any more
        ("jitter", 0.0, 0.0),
        ("rate", None, None),
        ("rate", 10.0, 10.0),
    ],
)
def test_a_value_stays_until_it_has_changed_noticeably(name: str, value: float | None, shown: float | None) -> None:
    now = measured(**{**SHOWN._asdict(), name: value})
    assert rounded(now, SHOWN) == SHOWN._replace(**{name: shown})
    assert differ_noticeably(SHOWN, now) is (shown != getattr(SHOWN, name))


@pytest.mark.parametrize(
    ("name", "before", "value", "shown"),
    [
        ("age", 0.5, 1.4, 0.5),  # at least by a second
        ("age", 0.5, 1.6, 1.6),
        ("jitter", 0.001, 0.0029, 0.001),  # at least by 2 ms
        ("jitter", 0.001, 0.0031, 0.0031),
        ("longest", 0.001, 0.0031, 0.0031),
        ("rate", 0.0, 0.001, 0.001),  # of a rate, any share counts
        ("age", None, 1.0, 1.0),
    ],
)
def test_a_small_value_is_refreshed_by_its_difference(
    name: str, before: float | None, value: float, shown: float
) -> None:
    earlier = SHOWN._replace(**{name: before})
    now = measured(**{**SHOWN._asdict(), name: value})
    assert rounded(now, earlier) == SHOWN._replace(**{name: shown})
    assert differ_noticeably(earlier, now) is (shown != before)


def test_what_is_shown_first_has_three_digits() -> None:
    assert rounded(measured(9.87654, 123.456, 0.00123456, 1234.5)) == Measurements(9.88, 123.0, 0.00123, 1230.0)
    assert rounded(measured(0.0, math.inf, 0.0, 0.1)) == Measurements(0.0, math.inf, 0.0, 0.1)
    assert rounded(measured(1.0, None, None, None)) == Measurements(1.0)


def test_where_nothing_is_measured_nothing_is_shown() -> None:
    assert rounded(None, SHOWN) == NOTHING_MEASURED == Measurements()
    assert differ_noticeably(SHOWN, None) and not differ_noticeably(NOTHING_MEASURED, None)
    for name in Measurements._fields:
        assert differ_noticeably(NOTHING_MEASURED._replace(**{name: 1.0}), None)
