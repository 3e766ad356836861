"""Samples of messages against field constraints."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from midstride.model.contract import Interval, OneOf, ValueSet
from midstride.node.author.field_checks import LONGEST, SHORTEST, FieldChecks
from midstride.wire.state import FieldSamples

MS = 1_000_000
START = 1_000_000_000_000
GOOD: tuple[tuple[str, ValueSet], ...] = (("visibility", Interval(low=1.5)),)


def seen(visibility: Any) -> Any:
    return SimpleNamespace(visibility=visibility)


def sampled(*values: Any, constraints: Any = GOOD) -> FieldSamples:
    checks = FieldChecks(constraints)
    for number, value in enumerate(values):
        checks.sample(seen(value), START + number * 20 * MS)
    (found,) = checks.samples().values()
    return found


def test_a_message_that_does_not_meet_the_constraint_is_counted_with_its_value() -> None:
    assert sampled(2.0, 1.4, 1.5, 0.5, 0.25) == FieldSamples(
        constraint=">= 1.5", checked=5, violations=3, run=2, last=0.25
    )


def test_the_last_violating_value_stays_when_messages_meet_the_constraint_again() -> None:
    found = sampled(1.0, 2.0, 3.0)
    assert (found.violations, found.run, found.last) == (1, 0, 1.0)


def test_no_violation_no_value() -> None:
    assert sampled(1.5, 2) == FieldSamples(constraint=">= 1.5", checked=2, violations=0, run=0)


def test_a_field_that_is_missing_or_of_no_plain_type_is_a_violation() -> None:
    assert sampled([1.0]).last == "[1.0]"
    missing = sampled(1.0, constraints=(("header.frame_id", OneOf.of(["map"])),))
    assert (missing.violations, missing.last) == (1, None)


def test_a_violating_text_is_shown_as_far_as_a_report_can_carry_it() -> None:
    assert sampled("\udc80").last == "\\udc80"
    long = sampled(1_000_000 * "x").last
    assert isinstance(long, str) and len(long) < 10_000


def test_nested_fields_and_texts() -> None:
    checks = FieldChecks((("header.frame_id", OneOf.of(["map"])),))
    for number, frame in enumerate(("map", "odom")):
        checks.sample(SimpleNamespace(header=SimpleNamespace(frame_id=frame)), START + number * 20 * MS)
    assert checks.samples() == {
        "header.frame_id": FieldSamples(constraint="= map", checked=2, violations=1, run=1, last="odom")
    }


def test_about_a_hundred_of_many_messages_a_second_are_checked() -> None:
    checks = FieldChecks(GOOD)
    for number in range(10_000):
        checks.sample(seen(2.0), START + number * MS)
    assert 800 < checks.samples()["visibility"].checked < 1_100


def test_checks_do_not_fall_in_step_with_a_publisher_that_alternates() -> None:
    """Every second message is wrong, at rates whose periods divide or equal the time between checks."""
    for period in (1, 2.5, 5, 7.5, 10):
        checks = FieldChecks(GOOD)
        for number in range(4_000):
            checks.sample(seen(2.0 if number % 2 else 1.0), START + round(number * period * MS))
        found = checks.samples()["visibility"]
        assert 0.3 < found.violations / found.checked < 0.7, period


def test_every_message_of_a_slow_publisher_is_checked() -> None:
    checks = FieldChecks(GOOD)
    for number in range(100):
        checks.sample(seen(2.0), START + number * LONGEST)
    assert checks.samples()["visibility"].checked == 100


def test_checks_go_on_where_the_clock_jumps_back() -> None:
    checks = FieldChecks(GOOD)
    checks.sample(seen(2.0), START)
    checks.sample(seen(2.0), START + SHORTEST - 1)
    assert checks.samples()["visibility"].checked == 1
    checks.sample(seen(2.0), START - 60_000 * MS)
    assert checks.samples()["visibility"].checked == 2


def test_another_mode_keeps_the_counts_of_what_it_requires_too() -> None:
    checks = FieldChecks(GOOD)
    checks.sample(seen(1.0), START)
    checks.require((*GOOD, ("width", OneOf.of([640]))))
    assert {path: found.violations for path, found in checks.samples().items()} == {"visibility": 1, "width": 0}
    checks.require(())
    assert not checks.active
    assert checks.samples() == {}
