"""Copies of messages in the simulator share nothing with the original, and are equal to it."""

from __future__ import annotations

import array
from typing import Any

import numpy
import pytest

from midstride.backends.simulator.message_copy import copied
from midstride.backends.simulator.messages import message_class


def path() -> Any:
    made = message_class("nav_msgs/msg/Path")()
    made.header.frame_id = "map"
    for x in (1.0, 2.0):
        pose = message_class("geometry_msgs/msg/PoseStamped")()
        pose.pose.position.x = x
        made.poses.append(pose)
    return made


def test_a_copy_is_equal_and_changes_on_its_own() -> None:
    first = path()
    second = copied(first)
    assert second == first and type(second) is type(first)
    second.poses[0].pose.position.x = 9.0
    second.poses.pop()
    second.header.stamp.sec = 5
    assert first == path()


def test_arrays_are_copied_too() -> None:
    scan: Any = message_class("sensor_msgs/msg/LaserScan")()
    odometry: Any = message_class("nav_msgs/msg/Odometry")()
    scan.ranges = array.array("f", [1.0, 2.0])
    odometry.pose.covariance[0] = 3.0
    scan_copy, odometry_copy = copied(scan), copied(odometry)
    scan_copy.ranges[0] = odometry_copy.pose.covariance[0] = 7.0
    assert scan.ranges[0] == 1.0 and odometry.pose.covariance[0] == 3.0
    assert odometry_copy.pose.covariance.dtype == numpy.float64


def test_messages_with_slots_as_ros_generates_them() -> None:
    class Point:
        __slots__ = ("_names", "_x")

        @classmethod
        def get_fields_and_field_types(cls) -> dict[str, str]:
            return {"x": "double", "names": "sequence<string>"}

        def __init__(self) -> None:
            self._x, self._names = 1.0, ["a"]

    first = Point()
    second = copied(first)
    second._x, second._names[0] = 2.0, "b"
    assert (first._x, first._names) == (1.0, ["a"])


@pytest.mark.parametrize("value", [{"a": [1]}, ([1],), bytearray(b"a"), frozenset({1})])
def test_whatever_else_a_message_has_is_copied_as_python_does(value: Any) -> None:
    copy = copied(value)
    assert copy == value and type(copy) is type(value)
    if isinstance(value, dict):
        copy["a"].append(2)
        assert value == {"a": [1]}


def test_subclasses_of_what_is_shared_keep_their_class() -> None:
    class Level(int):
        pass

    assert type(copied(Level(3))) is Level
