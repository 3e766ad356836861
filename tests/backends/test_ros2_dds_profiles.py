"""What Midstride sets for the middleware, and that it knows whether it took effect."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from midstride.backends.ros2 import dds_profiles
from midstride.backends.ros2.dds_profiles import PROFILE_VARIABLES, PROFILES, RANGE, TRANSPORTS, choose
from tests.backends.ros2_support import tuned_environment

FAST_DDS = "rmw_fastrtps_cpp"
LOCAL = {RANGE: "LOCALHOST"}


@pytest.mark.parametrize(
    ("major", "variable"), [(3, "FASTDDS_DEFAULT_PROFILES_FILE"), (2, "FASTRTPS_DEFAULT_PROFILES_FILE")]
)
def test_each_fast_dds_has_a_variable_of_its_own(major: int, variable: str) -> None:
    assert choose({}, FAST_DDS, major).variables == {
        variable: str(PROFILES / f"fastdds{major}_subnet.xml"),
        TRANSPORTS: "UDPv4?sockets_size=4MB",
    }
    assert choose(LOCAL, FAST_DDS, major).variables == {
        variable: str(PROFILES / f"fastdds{major}_localhost.xml"),
        RANGE: "SYSTEM_DEFAULT",
    }


@pytest.mark.parametrize(
    ("environment", "left", "words"),
    [
        ({"FASTDDS_DEFAULT_PROFILES_FILE": "/my.xml"}, set(), "your own profile"),
        ({"FASTRTPS_DEFAULT_PROFILES_FILE": "/my.xml", **LOCAL}, set(), "your own profile"),
        ({TRANSPORTS: "LARGE_DATA"}, {"FASTDDS_DEFAULT_PROFILES_FILE"}, "LARGE_DATA"),
        ({TRANSPORTS: "LARGE_DATA", **LOCAL}, {"FASTDDS_DEFAULT_PROFILES_FILE"}, "LARGE_DATA"),
    ],
)
def test_what_the_user_has_set_is_kept(environment: dict[str, str], left: set[str], words: str) -> None:
    chosen = choose(environment, FAST_DDS, 3)
    assert set(chosen.variables) == left
    assert words in " ".join(chosen.warnings)


@pytest.mark.parametrize("own", [{"ROS_STATIC_PEERS": "10.0.0.2"}, {"ROS_LOCALHOST_ONLY": "1"}])
def test_what_rmw_alone_understands_is_left_to_it(own: dict[str, str]) -> None:
    assert RANGE not in choose({**LOCAL, **own}, FAST_DDS, 3).variables


def test_what_is_set_and_what_is_left_is_described() -> None:
    environment = {TRANSPORTS: "LARGE_DATA", "ROS_DOMAIN_ID": "3", "RMW_IMPLEMENTATION": FAST_DDS, "HOME": "/root"}
    chosen = choose(environment, FAST_DDS, 3)
    described = chosen.described(environment, chosen.warnings)
    assert described.name == FAST_DDS
    assert described.set == chosen.variables and list(described.set) == ["FASTDDS_DEFAULT_PROFILES_FILE"]
    assert described.kept == {TRANSPORTS: "LARGE_DATA", "RMW_IMPLEMENTATION": FAST_DDS}
    assert described.notes == [f"transports: your own {TRANSPORTS}=LARGE_DATA is used"]


def test_what_midstride_replaces_is_not_called_kept() -> None:
    chosen = choose(LOCAL, FAST_DDS, 3)
    assert RANGE in chosen.variables and chosen.described(LOCAL, ()).kept == {}


@pytest.mark.ros2
def test_switched_off_nothing_is_set() -> None:
    off = dds_profiles.of_this_process(enabled=False)
    assert off.variables == {} and "--no-middleware-settings" in off.warnings[0]


def test_other_middlewares_keep_their_defaults_with_a_warning() -> None:
    chosen = choose({}, "rmw_cyclonedds_cpp", None)
    assert chosen.variables == {}
    assert "rmw_cyclonedds_cpp" in chosen.warnings[0]
    assert choose({}, FAST_DDS, None).warnings


@pytest.mark.parametrize("environment", [{}, LOCAL])
def test_what_is_set_already_stays_as_it_is(environment: dict[str, str]) -> None:
    first = choose(environment, FAST_DDS, 3)
    again = choose({**environment, **first.variables}, FAST_DDS, 3)
    assert (again.variables, again.warnings) == ({}, ())


# What Fast DDS 3 has renamed. The flow controller, or the throughput controller, is without a limit that matters.
RENAMED = {
    "heartbeatPeriod": "heartbeat_period",
    "throughputController": "flow_controller_descriptor_list",
}


def elements(major: int, kind: str) -> list[tuple[str, str]]:
    """The elements of a profile and their text, in the names of Fast DDS 3; not the property that only it has."""
    root = ElementTree.parse(PROFILES / f"fastdds{major}_{kind}.xml").getroot()
    policies = [element for element in root.iter() if element.tag.endswith("}propertiesPolicy")]
    of_its_own = {element for policy in policies for element in policy.iter()}
    found = []
    for element in root.iter():
        if element in of_its_own:
            continue
        name = element.tag.partition("}")[2]
        assert name not in (RENAMED if major == 3 else RENAMED.values())
        found.append((RENAMED.get(name, name), (element.text or "").strip()))
    return found


@pytest.mark.parametrize("kind", ["subnet", "localhost"])
def test_the_profiles_of_both_versions_say_the_same(kind: str) -> None:
    """Fast DDS 3 has renamed some elements; an unknown one makes it drop the whole file."""
    old, new = elements(2, kind), elements(3, kind)
    controllers = {2: ["bytesPerPeriod", "periodMillisecs"], 3: ["flow_controller_descriptor", "name"]}
    assert [each for each in old if each[0] not in controllers[2]] == [
        each for each in new if each[0] not in controllers[3]
    ]
    assert ("nanosec", "100000000") in new
    for name in ("discovery_config", "leaseDuration"):
        assert name not in dict(old), "the lease and the announcements keep their defaults"


def test_the_environment_is_as_it_was_afterwards(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(RANGE, "LOCALHOST")
    monkeypatch.delenv(TRANSPORTS, raising=False)
    chosen = dds_profiles.DdsSettings(FAST_DDS, {RANGE: "SYSTEM_DEFAULT", TRANSPORTS: "UDPv4"})
    with dds_profiles.applied_profile(chosen):
        assert (os.environ[RANGE], os.environ[TRANSPORTS]) == ("SYSTEM_DEFAULT", "UDPv4")
    assert os.environ[RANGE] == "LOCALHOST"
    assert TRANSPORTS not in os.environ


def test_which_fast_dds_another_interpreter_has(tmp_path: Path) -> None:
    (tmp_path / "lib").mkdir()
    assert dds_profiles.installed_major(tmp_path) is None
    (tmp_path / "lib" / "libfastrtps.so.2.14").touch()
    assert dds_profiles.installed_major(tmp_path) == 2


CHECKING = """
import sys
from pathlib import Path

import rclpy
from midstride.backends.ros2 import dds_profiles

if "before" in sys.argv:
    rclpy.init()
    rclpy.create_node("before").destroy_node()
    rclpy.shutdown()
chosen = dds_profiles.of_this_process()
with dds_profiles.applied_profile(chosen) as warnings:
    rclpy.init()
    node = rclpy.create_node("checked")
    Path(chosen.profile or "").read_text()  # as another process does that starts now
print(sorted(chosen.variables), "|", *warnings)
if "threads" in sys.argv:
    print(*(task.read_text() for task in Path("/proc/self/task").glob("*/comm")))
node.destroy_node()
rclpy.shutdown()
"""


def checked(*arguments: str, **environment: str) -> str:
    kept = {name: value for name, value in os.environ.items() if name not in (*PROFILE_VARIABLES.values(), TRANSPORTS)}
    return subprocess.run(
        [sys.executable, "-c", CHECKING, *arguments],
        env={**kept, **environment},
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    ).stdout


@pytest.mark.ros2
@pytest.mark.fast_dds
def test_a_profile_that_took_effect_is_recognized() -> None:
    assert checked(**LOCAL).rstrip().endswith("|")
    assert RANGE in checked(**LOCAL)


@pytest.mark.ros2
@pytest.mark.fast_dds
def test_a_profile_that_came_too_late_is_recognized() -> None:
    assert "this process has used ROS 2 before" in checked("before", **LOCAL)


@pytest.mark.ros2
@pytest.mark.fast_dds
def test_shared_memory_in_use_is_recognized() -> None:
    assert "shared memory is in use" in checked(**LOCAL, ROS_STATIC_PEERS="127.0.0.1")


@pytest.mark.ros2
@pytest.mark.fast_dds
@pytest.mark.parametrize("environment", [{RANGE: "SUBNET"}, LOCAL])
def test_no_type_is_looked_up(environment: dict[str, str]) -> None:
    """Fast DDS 3.2 has crashed in `TypeLookupManager::notify_callbacks`, in the thread that receives replies."""
    threads = checked("threads", **environment)
    assert "dds.udp" in threads
    assert "dds.tls" not in threads


JOINING = """
import sys
import time

import rclpy
from rclpy.duration import Duration
from std_msgs.msg import String

rclpy.init()
node = rclpy.create_node(sys.argv[1])
if sys.argv[1] == "listener":
    node.create_subscription(String, "/joining", lambda message: None, 10)
    print("listens", flush=True)
    rclpy.spin(node)
begun = time.monotonic()
publisher = node.create_publisher(String, "/joining", 10)
while not publisher.get_subscription_count():
    time.sleep(0.001)
matched = time.monotonic()
publisher.publish(String())
assert publisher.wait_for_all_acked(Duration(seconds=10))
print(matched - begun, time.monotonic() - matched)
"""


@pytest.mark.ros2
@pytest.mark.fast_dds
@pytest.mark.parametrize("environment", [{RANGE: "SUBNET"}, LOCAL])
def test_a_new_process_is_matched_and_acknowledged_long_before_the_next_announcement(
    environment: dict[str, str],
) -> None:
    """With the defaults of Fast DDS, either of the two takes nearly 3 s: of five times, so does the median."""
    command = [sys.executable, "-c", JOINING]
    tuned = tuned_environment({**os.environ, **environment})
    with subprocess.Popen([*command, "listener"], env=tuned, stdout=subprocess.PIPE, text=True) as listener:
        try:
            assert listener.stdout is not None and listener.stdout.readline()
            seconds = [
                [float(word) for word in subprocess.check_output([*command, "talker"], env=tuned, timeout=60).split()]
                for _ in range(5)
            ]
        finally:
            listener.kill()
    matched, acknowledged = (sorted(column)[2] for column in zip(*seconds, strict=True))
    assert matched < 1.0
    assert acknowledged < 1.0


@pytest.mark.ros2
@pytest.mark.fast_dds
def test_the_101st_process_of_a_host_is_heard() -> None:
    """The ports of a domain allow 120, and Fast DDS tries the first 100 by default."""
    tuned = tuned_environment({**os.environ, **LOCAL})
    first = 7400 + 250 * int(os.environ.get("ROS_DOMAIN_ID", "0")) + 10  # DDSI-RTPS 9.6.2.3
    command = [sys.executable, "-c", JOINING]
    with contextlib.ExitStack() as stack:
        for number in range(101):
            taken = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            with contextlib.suppress(OSError):  # taken already, by another process of this domain
                taken.bind(("", first + 2 * number))
        listener = stack.enter_context(
            subprocess.Popen([*command, "listener"], env=tuned, stdout=subprocess.PIPE, text=True)
        )
        stack.callback(listener.kill)
        assert listener.stdout is not None and listener.stdout.readline()
        assert subprocess.check_output([*command, "talker"], env=tuned, timeout=60)
