"""Message types: read from interface files and from the type store, with nothing of ROS imported."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from midstride.lang.message_types import (
    InstalledTypes,
    MessageDefinition,
    MissingField,
    field_kind,
    installed,
    parse_fields,
    share_folders,
)

from .known import Known


def test_fields_of_an_interface_file() -> None:
    text = (
        "uint8 A=1 # one\nstring<=5 name # bounded\nfloat32[3] three\nint32[<=4] some\n"
        "Header header\nPoint at\nbool on true\n"
    )
    assert parse_fields(text, "my_msgs") == {
        "name": "text",
        "three": "list",
        "some": "list",
        "header": "std_msgs/msg/Header",
        "at": "my_msgs/msg/Point",
        "on": "boolean",
    }


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        ("width", "number"),
        ("encoding", "text"),
        ("data", "list"),
        ("header", "std_msgs/msg/Header"),
        ("header.frame_id", "text"),
        ("header.stamp.sec", "unknown"),
        ("header.frame", MissingField("std_msgs/msg/Header", "frame", ("stamp", "frame_id"))),
        ("width.x", MissingField("a number", "x", ())),
    ],
)
def test_what_a_field_is(path: str, expected: object) -> None:
    message = Known().message("sensor_msgs/msg/Image")
    assert message is not None
    assert field_kind(Known(), message, path) == expected


def test_installed_packages_come_before_the_type_store(tmp_path: Path) -> None:
    (tmp_path / "my_msgs" / "msg").mkdir(parents=True)
    (tmp_path / "my_msgs" / "msg" / "Odd.msg").write_text("float64 oddness\n")
    found = InstalledTypes([tmp_path], lambda: Known())
    assert found.message("my_msgs/msg/Odd") == MessageDefinition("my_msgs/msg/Odd", {"oddness": "number"})
    assert list(found.types("my_msgs")) == ["Odd"]
    assert found.message("my_msgs/msg/Even") is None
    assert found.message("std_msgs/msg/String") == MessageDefinition("std_msgs/msg/String", {"data": "text"})
    assert list(found.types("other_msgs")) == []


def test_the_type_store_serves_where_no_ros_is() -> None:
    """`installed` knows ROS's own messages on any machine, and asking imports nothing of ROS."""
    before = set(sys.modules)
    image = installed({}).message("sensor_msgs/msg/Image")
    assert image is not None
    assert image.fields["width"] == "number"
    assert image.fields["data"] == "list"
    assert image.fields["header"] == "std_msgs/msg/Header"
    assert installed({}).message("sensor_msgs/msg/Imag") is None
    assert not {name for name in set(sys.modules) - before if name.startswith(("rclpy", "rospy", "sensor_msgs"))}


def test_where_packages_are_looked_for() -> None:
    folders = share_folders({"AMENT_PREFIX_PATH": "/opt/ros/x:/ws/install/y", "ROS_PACKAGE_PATH": "/cat/src"})
    assert folders == [
        Path("/opt/ros/x/share"),
        Path("/ws/install/y/share"),
        Path(sys.prefix, "share"),
        Path("/cat/src"),
    ]
