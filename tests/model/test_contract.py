"""Satisfaction, clause by clause (docs/semantics.md section 1)."""

from __future__ import annotations

import pytest

from midstride.model.contract import (
    NOTHING,
    Contract,
    Interval,
    OneOf,
    Predicate,
    QoS,
    canonical_type,
    explain,
    format_number,
    satisfies,
)

SCAN = "sensor_msgs/msg/LaserScan"


def test_types_of_ros_1_and_ros_2_are_the_same() -> None:
    assert canonical_type("sensor_msgs/LaserScan") == canonical_type(SCAN) == SCAN
    assert Predicate("sensor_msgs/LaserScan") == Predicate(SCAN)


SATISFIED: list[tuple[str, Contract, Contract]] = [
    ("as fast", Predicate(SCAN, 10), Predicate(SCAN, 10)),
    ("faster", Predicate(SCAN, 10.5), Predicate(SCAN, 10)),
    ("no rate is needed", Predicate(SCAN), Predicate(SCAN)),
    ("what is not needed may be stated", Predicate(SCAN, 1, fields=(("w", OneOf.of([1])),)), Predicate(SCAN)),
    ("defaults written out", Predicate(SCAN, qos=QoS("reliable", "volatile", liveliness="automatic")), Predicate(SCAN)),
    ("defaults needed in writing", Predicate(SCAN), Predicate(SCAN, qos=QoS("reliable", "volatile"))),
    ("reliable for best effort", Predicate(SCAN), Predicate(SCAN, qos=QoS("best_effort"))),
    ("latched for volatile", Predicate(SCAN, qos=QoS(durability="transient_local")), Predicate(SCAN)),
    ("a shorter deadline", Predicate(SCAN, qos=QoS(deadline=0.1)), Predicate(SCAN, qos=QoS(deadline=0.2))),
    ("a shorter lease", Predicate(SCAN, qos=QoS(lease=0.1)), Predicate(SCAN, qos=QoS(lease=0.2))),
    ("asserted by hand", Predicate(SCAN, qos=QoS(liveliness="manual_by_topic")), Predicate(SCAN)),
    ("what plays no part", Predicate(SCAN, qos=QoS(depth=1, history="keep_all", lifespan=1)), Predicate(SCAN)),
    (
        "a value in a range",
        Predicate(SCAN, fields=(("width", OneOf.of([1280])),)),
        Predicate(SCAN, fields=(("width", Interval(low=640)),)),
    ),
    (
        "fewer values",
        Predicate(SCAN, fields=(("encoding", OneOf.of(["rgb8"])),)),
        Predicate(SCAN, fields=(("encoding", OneOf.of(["rgb8", "bgr8"])),)),
    ),
]


@pytest.mark.parametrize(("offered", "needed"), [case[1:] for case in SATISFIED], ids=[case[0] for case in SATISFIED])
def test_satisfied(offered: Contract, needed: Contract) -> None:
    assert satisfies(offered, needed)
    assert explain(offered, needed) == []


W, E = "width", "encoding"
UNSATISFIED: list[tuple[Contract, Contract, list[str]]] = [
    (NOTHING, Predicate(SCAN), ["nothing is guaranteed"]),
    (NOTHING, NOTHING, ["nothing is guaranteed"]),
    (Predicate(SCAN), NOTHING, ["nothing can satisfy `nothing`"]),
    (
        Predicate("nav_msgs/Odometry"),
        Predicate(SCAN),
        [f"type: nav_msgs/msg/Odometry is offered, {SCAN} is needed"],
    ),
    (Predicate(SCAN), Predicate(SCAN, 5), ["rate: no rate is offered, at least 5 Hz is needed"]),
    (Predicate(SCAN, 4.9), Predicate(SCAN, 5), ["rate: 4.9 Hz is offered, at least 5 Hz is needed"]),
    (
        Predicate(SCAN, qos=QoS("best_effort")),
        Predicate(SCAN),
        ["reliability: best_effort is offered, reliable is needed"],
    ),
    (
        Predicate(SCAN),
        Predicate(SCAN, qos=QoS(durability="transient_local", deadline=0.1, liveliness="manual_by_topic", lease=2)),
        [
            "durability: volatile is offered, transient_local is needed",
            "deadline: none is offered, at most 0.1 s is needed",
            "lease: none is offered, at most 2 s is needed",
            "liveliness: automatic is offered, manual_by_topic is needed",
        ],
    ),
    (
        Predicate(SCAN),
        Predicate(SCAN, fields=((W, Interval(low=640)),)),
        ["field width: not constrained, width >= 640 is needed"],
    ),
    (
        Predicate(SCAN, fields=((W, Interval(low=640)), (E, OneOf.of(["mono8"])))),
        Predicate(SCAN, fields=((W, Interval(low=640, low_open=True)), (E, OneOf.of(["rgb8", "bgr8"])))),
        [
            "field encoding: encoding = mono8 is offered, encoding in {bgr8, rgb8} is needed",
            "field width: width >= 640 is offered, width > 640 is needed",
        ],
    ),
    (
        Predicate(SCAN, 33.3333333, fields=((W, Interval(0.1234567, 1234567)),)),
        Predicate(SCAN, 33.3333334, fields=((W, Interval(0.1234568, 1234567)),)),
        [
            "rate: 33.3333333 Hz is offered, at least 33.3333334 Hz is needed",
            "field width: width in [0.1234567, 1234567] is offered, width in [0.1234568, 1234567] is needed",
        ],
    ),
]


@pytest.mark.parametrize(("offered", "needed", "clauses"), UNSATISFIED)
def test_unsatisfied_and_why(offered: Contract, needed: Contract, clauses: list[str]) -> None:
    assert not satisfies(offered, needed)
    assert explain(offered, needed) == clauses


@pytest.mark.parametrize(
    ("number", "text"),
    [(10.0, "10"), (0.1, "0.1"), (1e18, "1e+18"), (8192, "8192"), (1234567, "1234567"), (1 / 3, "0.3333333333333333")],
)
def test_numbers_are_told_in_the_fewest_digits_that_tell_them_apart(number: float, text: str) -> None:
    assert format_number(number) == text
    assert float(text) == number


def test_every_clause_is_told_at_once() -> None:
    offered = Predicate("std_msgs/String", 1, QoS("best_effort"))
    needed = Predicate(SCAN, 5, fields=((W, Interval(0, 1)),))
    assert len(explain(offered, needed)) == 4


def test_numbers_are_reals_and_booleans_are_not_numbers() -> None:
    assert OneOf.of([1]) == OneOf.of([1.0])
    assert OneOf.of([True]) != OneOf.of([1])
    assert True not in Interval(0, 1)
    assert not OneOf.of([True]).is_subset(Interval(0, 1))
    assert "1" not in OneOf.of([1])


def test_constraints_on_one_field_are_one_set() -> None:
    both = Predicate(SCAN, fields=((W, Interval(low=640)), (W, Interval(high=1280, high_open=True))))
    assert both == Predicate(SCAN, fields=((W, Interval(640, 1280, high_open=True)),))
    assert str(both) == f"{SCAN} where width in [640, 1280)"
    point = Predicate(SCAN, fields=((W, Interval(640, 640)),))
    assert point == Predicate(SCAN, fields=((W, OneOf.of([640])),))
    none = Predicate(SCAN, fields=((W, Interval(low=2)), (W, Interval(high=1))))
    assert none.fields[0][1].is_empty


def test_the_order_of_fields_plays_no_part() -> None:
    one = Predicate(SCAN, fields=((W, OneOf.of([1])), (E, OneOf.of(["a"]))))
    other = Predicate(SCAN, fields=((E, OneOf.of(["a"])), (W, OneOf.of([1]))))
    assert one == other
    assert hash(one) == hash(other)


def test_an_interval_of_one_value_lies_in_a_set_that_has_it() -> None:
    assert Interval(1, 1).is_subset(OneOf.of([1, 2]))
    assert not Interval(1, 2).is_subset(OneOf.of([1, 2]))
    assert Interval(1, 1, low_open=True).is_subset(OneOf.of([]))


@pytest.mark.parametrize(
    ("predicate", "text"),
    [
        (Predicate(SCAN), SCAN),
        (Predicate(SCAN, 10.0), f"{SCAN} @ 10 Hz"),
        (
            Predicate(SCAN, 2.5, QoS("best_effort", depth=5)),
            f"{SCAN} @ 2.5 Hz qos(reliability = best_effort, depth = 5)",
        ),
        (Predicate(SCAN, fields=((W, Interval(high=3, high_open=True)),)), f"{SCAN} where width < 3"),
        (
            Predicate(SCAN, fields=(("header.frame_id", OneOf.of(["a link"])),)),
            f'{SCAN} where header.frame_id = "a link"',
        ),
        (Predicate(SCAN, fields=(("on", OneOf.of([True])),)), f"{SCAN} where on = true"),
    ],
)
def test_predicates_read_as_in_the_language(predicate: Predicate, text: str) -> None:
    assert str(predicate) == text


def test_endpoints_are_the_same_with_defaults_written_out() -> None:
    assert QoS().same_endpoint(QoS("reliable", "volatile", liveliness="automatic", depth=10, history="keep_last"))
    assert not QoS().same_endpoint(QoS(depth=5))
