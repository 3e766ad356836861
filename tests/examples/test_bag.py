"""What the independent check of a bag finds, and does not find, in bags that are written here."""

from __future__ import annotations

import ast
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy
import pytest
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore

from tests.examples.conftest import EXAMPLES

STORE = get_typestore(Stores.ROS2_JAZZY)
START = 1_000.0
LIMITS = {"topic": "/cmd_vel", "silence": 0.5, "stale": 0.5, "reaction": 0.5, "silent": []}
EVENTS = [{"name": "first", "from": 1000.0, "to": 1002.0}, {"name": "second", "from": 1002.0, "to": 1004.0}]

# Who sends which of its commands, and when (s from the start).
Commands = Sequence[tuple[str | None, int, float]]
STEADY: Commands = [("a", n + 1, 0.05 * n) for n in range(80)]


def message(name: str, **fields: Any) -> Any:
    return STORE.types[f"{name[: name.index('/')]}/msg/{name[name.index('/') + 1 :]}"](**fields)


def stamped(seconds: float) -> Any:
    stamp = message("builtin_interfaces/Time", sec=int(seconds), nanosec=round(seconds % 1 * 1e9))
    return message("std_msgs/Header", stamp=stamp, frame_id="")


def scan(seconds: float) -> Any:
    nothing = numpy.zeros(0, dtype=numpy.float32)
    figures = dict.fromkeys(("angle_min", "angle_max", "angle_increment", "time_increment", "scan_time"), 0.0)
    ranges = {"range_min": 0.1, "range_max": 4.0, "ranges": nothing, "intensities": nothing}
    return message("sensor_msgs/LaserScan", header=stamped(seconds), **figures, **ranges)


def wheels(seconds: float, speed: float) -> Any:
    zero = message("geometry_msgs/Vector3", x=0.0, y=0.0, z=0.0)
    forward = message("geometry_msgs/Vector3", x=speed, y=0.0, z=0.0)
    twist = message("geometry_msgs/Twist", linear=forward, angular=zero)
    point = message("geometry_msgs/Point", x=0.0, y=0.0, z=0.0)
    level = message("geometry_msgs/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    unknown = numpy.zeros(36)
    pose = message(
        "geometry_msgs/PoseWithCovariance",
        pose=message("geometry_msgs/Pose", position=point, orientation=level),
        covariance=unknown,
    )
    velocity = message("geometry_msgs/TwistWithCovariance", twist=twist, covariance=unknown)
    return message("nav_msgs/Odometry", header=stamped(seconds), child_frame_id="", pose=pose, twist=velocity)


@pytest.fixture
def check(
    tmp_path: Path, patrol: Callable[[str], ModuleType], capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, list[dict[str, Any]]]]:
    """Checks a bag of ``commands``, with a scan every 0.1 s but in ``unseen``, of a robot that moves at ``speed``."""

    def checked(
        commands: Commands, unseen: tuple[float, float] = (9.0, 9.0), speed: float = 1.0, **limits: Any
    ) -> tuple[int, list[dict[str, Any]]]:
        entries: list[tuple[float, str, str, Any]] = []
        for writer, number, sent in commands:
            words = {"topic": "/cmd_vel", "writer": writer, "number": number, "sent": round((START + sent) * 1e9)}
            info = message("std_msgs/String", data=json.dumps(words))
            entries.append((sent, "/recorder/info", "std_msgs/msg/String", info))
        for tenth in range(40):
            at = tenth / 10
            if not unseen[0] <= at < unseen[1]:
                entries.append((at, "/obstacles/near", "sensor_msgs/msg/LaserScan", scan(START + at)))
            entries.append((at + 0.01, "/device/wheels", "nav_msgs/msg/Odometry", wheels(START + at, speed)))
        with Writer(tmp_path / "bag", version=9) as bag:
            connections: dict[str, Any] = {}
            for at, topic, kind, body in sorted(entries, key=lambda entry: entry[0]):
                if topic not in connections:
                    connections[topic] = bag.add_connection(topic, kind, typestore=STORE)
                bag.write(connections[topic], round((START + at) * 1e9), STORE.serialize_cdr(body, kind))
        announced = tmp_path / "announced.json"
        announced.write_text(json.dumps({**LIMITS, "events": EVENTS, **limits}))
        status: int = patrol("check_bag").main(str(tmp_path / "bag"), str(announced))
        return status, [json.loads(line) for line in capsys.readouterr().out.splitlines()]

    return checked


@pytest.mark.parametrize("program", ["check_bag.py", "recorder.py"])
def test_what_records_and_what_checks_know_nothing_of_midstride(program: str) -> None:
    tree = ast.parse((EXAMPLES / "patrol" / program).read_text())
    imported = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    imported |= {node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    files = {file.stem for file in (EXAMPLES / "patrol").glob("*.py")}
    assert imported and not {name for name in imported if name.partition(".")[0] in {"midstride", *files}}


def test_a_steady_robot_is_found_to_be_one(check: Any) -> None:
    status, (first, second, whole) = check(STEADY)
    assert status == 0 and whole["holds"]
    assert (whole["commands"], whole["writers"]) == (80, 1)
    nothing = {"lost": 0, "interleaved": 0, "silence": 0.0, "moved_blind": 0.0}
    assert first == {"name": "first", **nothing} and second == {"name": "second", **nothing}


def test_a_command_that_did_not_arrive_is_missed_unless_that_was_announced(check: Any) -> None:
    commands = [each for each in STEADY if each[1] not in (20, 21)]
    status, (first, second, whole) = check(commands)
    assert (status, first["lost"], second["lost"], whole["holds"]) == (1, 2, 0, False)


def test_an_announced_interval_may_be_without_commands(check: Any) -> None:
    commands = [each for each in STEADY if not 1.0 <= each[2] < 1.8]
    status, lines = check(commands, silent=[{"from": START + 0.9, "to": START + 1.9}])
    assert (status, lines[-1]["lost"], lines[-1]["silence"]) == (0, 0, 0.0)


def test_a_silence_is_found_though_the_writer_s_numbers_go_on(check: Any) -> None:
    commands = [("a", n + 1, 0.05 * n + (0.7 if n >= 50 else 0.0)) for n in range(60)]
    status, (first, second, whole) = check(commands)
    assert (status, first["silence"], whole["lost"]) == (1, 0.0, 0)
    assert second["silence"] == pytest.approx(0.75)


def test_writers_that_are_not_reported_are_told_apart_by_their_numbers(check: Any) -> None:
    """The second goes past the last number of the first."""
    first = [(None, n + 1, 0.05 * n) for n in range(30)]
    second = [(None, n + 1, 0.05 * (n + 30)) for n in range(50)]
    status, (*_, whole) = check([*first, *second])
    assert (status, whole["writers"], whole["lost"], whole["interleaved"]) == (0, 2, 0, 0)


def test_writers_that_are_not_reported_are_found_to_interleave(check: Any) -> None:
    first = [(None, n + 1, 0.05 * n) for n in range(60)]
    second = [(None, n + 1, 0.05 * (n + 30) + 0.01) for n in range(50) if n != 20]
    status, (*_, whole) = check([*first, *second])
    assert (status, whole["writers"], whole["lost"]) == (1, 2, 1)
    assert whole["interleaved"] >= 30


def test_a_hand_over_is_no_interleaving_and_two_at_once_are(check: Any) -> None:
    old = [("old", n + 1, 0.05 * n) for n in range(40)]
    new = [("new", n + 1, 2.0 + 0.05 * n) for n in range(40)]
    assert check([*old, *new])[1][-1]["interleaved"] == 0


def test_an_old_writer_that_writes_again_interleaves(check: Any) -> None:
    old = [("old", n + 1, 0.05 * n) for n in range(41)]
    new = [("new", n + 1, 1.975 + 0.05 * n) for n in range(40)]
    status, lines = check([*old, *new])
    # The last of the old one comes between the first two of the new one, and those that follow it come after it.
    assert status == 1 and lines[-1]["interleaved"] == 40


@pytest.mark.parametrize(("speed", "seconds", "status"), [(1.0, 0.7, 1), (0.0, 0.0, 0)])
def test_moving_on_what_was_seen_long_ago_is_found(check: Any, speed: float, seconds: float, status: int) -> None:
    found, lines = check(STEADY, unseen=(1.0, 2.2), speed=speed)
    assert found == status
    assert lines[-1]["moved_blind"] == pytest.approx(seconds, abs=0.01)
