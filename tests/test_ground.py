"""The environment that `make` sets up: what is installed, and that its ROS 2 works between two processes."""

from __future__ import annotations

import importlib.metadata
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tools import suites

ROOT = Path(__file__).parent.parent


def test_nothing_depends_on_lark() -> None:
    """It would fill the same folder as `lark-parser`, which the ROS wheels need, and break them when it goes."""
    named = {
        re.split(r"[\s\[<>=!~;(]", requirement, maxsplit=1)[0].lower()
        for distribution in importlib.metadata.distributions()
        if not str(distribution.metadata["Name"]).lower().startswith("ros-")
        for requirement in distribution.requires or ()
        if "extra ==" not in requirement
    }
    assert "lark" not in named
    assert not re.search(r'"lark\b(?!-parser)', (ROOT / "pyproject.toml").read_text(encoding="utf-8"))


ANSWERING = """
import rclpy
from std_msgs.msg import String
from std_srvs.srv import Trigger

rclpy.init()
node = rclpy.create_node("answering")
heard = []
node.create_subscription(String, "/ground/said", lambda message: heard.append(message.data), 10)

def answer(request, response):
    response.success, response.message = bool(heard), " ".join(heard)
    return response

node.create_service(Trigger, "/ground/heard", answer)
print(rclpy.__file__, flush=True)
while True:
    rclpy.spin_once(node, timeout_sec=0.1)
"""

ASKING = """
import sys, time
import rclpy
from std_msgs.msg import String
from std_srvs.srv import Trigger

rclpy.init()
node = rclpy.create_node("asking")
publisher = node.create_publisher(String, "/ground/said", 10)
client = node.create_client(Trigger, "/ground/heard")
end = time.monotonic() + 30
while time.monotonic() < end:
    publisher.publish(String(data="ground"))
    future = client.call_async(Trigger.Request())
    rclpy.spin_until_future_complete(node, future, timeout_sec=1.0)
    if future.done() and future.result().success:
        print(future.result().message.split()[0], flush=True)
        break
node.destroy_node()
rclpy.shutdown()
"""


def test_each_test_in_quarantine_exists_and_has_a_reason() -> None:
    entries = suites.quarantine(suites.QUARANTINE.read_text(encoding="utf-8"))
    assert [test for test, reason in entries.items() if len(reason.split()) < 10] == []
    if entries:
        command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-p", "no:cacheprovider", *entries]
        found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        assert set(entries) <= set(found.stdout.splitlines()), found.stdout + found.stderr


def test_the_file_of_the_quarantine_is_read_as_it_is_written() -> None:
    text = "# why\n\ntests/a.py::test_b[0.5]\n    It is\n    late.\ntests/c.py::test_d\n"
    assert suites.quarantine(text) == {"tests/a.py::test_b[0.5]": "It is late.", "tests/c.py::test_d": ""}


FAILING = """
from pathlib import Path

def test_passes():
    pass

def test_fails():
    tried = Path(__file__).with_name("tried")
    with tried.open("a") as file:
        file.write("x")
    assert tried.stat().st_size > FAILS, "not yet"
"""


@pytest.mark.parametrize(
    ("listed", "live", "fails", "rounds"),
    [
        (True, False, 1, 2),  # once is enough
        (True, False, 2, 3),
        (False, False, 1, 1),  # what computes does not run again
        (False, True, 1, 3),  # twice in a row
        (False, True, 2, 2),
    ],
)
def test_what_is_in_quarantine_or_live_runs_again(
    listed: bool,
    live: bool,
    fails: int,
    rounds: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "test_it.py").write_text(FAILING.replace("FAILS", str(fails)), encoding="utf-8")
    entry = "test_it.py::test_fails\n    It fails.\n" if listed else ""
    (tmp_path / "quarantine.txt").write_text(entry, encoding="utf-8")
    monkeypatch.setattr(suites, "QUARANTINE", tmp_path / "quarantine.txt")
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    bare = ["--disable-plugin-autoload", "-p", "xdist.plugin", "-c", os.devnull, "--rootdir", str(tmp_path)]
    suite = suites.Suite("one", ["env"], [*bare, "test_it.py"], live=live)
    suites.run_all([[suite]])
    assert (suite.status, suite.ends()) == (1, {"passed": 1, "failed": 1})
    again = suites.run_again([suite])
    reason = "It fails." if listed else suites.BESIDE_OTHERS
    assert again == ([f"one: test_it.py::test_fails ({reason})"] if rounds > 1 else [])
    passes = (listed and fails < 3) or (live and fails < 2)
    assert (suite.has_passed, suite.rounds) == (passes, rounds)
    assert suite.ends() == ({"passed": 2} if passes else {"passed": 1, "failed": 1})
    assert "not yet" in capsys.readouterr().out


def test_of_too_many_that_have_failed_none_runs_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    suite = suites.Suite("one", ["false"], ["-q"], live=True, status=1)
    monkeypatch.setattr(suites.Suite, "failed_tests", lambda _: {f"test_{n}" for n in range(suites.MOST_AGAIN + 1)})
    assert suites.run_again([suite]) == [] and suite.rounds == 0


def test_what_computes_is_there_and_runs_apart_from_what_is_timed() -> None:
    files = suites.computing_files()
    assert all((ROOT / file).is_file() for file in (*files, *suites.TIMED))
    assert len(files) > 100 and len(files) == len(set(files))
    assert not set(suites.TIMED) & set(files)
    assert all(any(file.startswith(each) for file in files) for each in suites.COMPUTING)
    for place in (*suites.PLATFORM, *suites.GATES, *suites.PAGES):
        path, _, test = place.partition("::")
        assert (ROOT / path).exists() and (not test or f"def {test}(" in (ROOT / path).read_text(encoding="utf-8"))


def test_what_watches_live_systems_runs_after_the_rest_but_for_the_tests_of_every_day() -> None:
    watching = {"waiting", "kilted", "gates", "pages"}
    names = ("waiting", "computing", "kilted", "gates", "pages", "ros1", "make lint")
    chosen = [suites.Suite(name, ["true"], watches=name in watching) for name in names]

    def stages(markers: str) -> list[list[list[str]]]:
        return [[[suite.name for suite in each] for each in stage] for stage in suites.stages(chosen, markers)]

    assert stages("not full and not long") == [[[name] for name in names]]
    watched = [["waiting"], ["kilted", "gates", "pages"]]
    assert stages("not long") == [[["computing"], ["ros1"], ["make lint"]], watched]
    assert stages("long") == [[[name]] for name in names]
    for stage in suites.stages(chosen, "not long"):
        suites.run_all(stage)
    assert all(suite.has_passed for suite in chosen)


@pytest.mark.ros2
def test_a_message_and_a_service_pass_between_two_processes() -> None:
    answering = subprocess.Popen([sys.executable, "-c", ANSWERING], stdout=subprocess.PIPE, text=True)
    try:
        asking = subprocess.run([sys.executable, "-c", ASKING], capture_output=True, text=True, timeout=50, check=False)
        assert asking.stdout == "ground\n", asking.stderr
    finally:
        answering.kill()
        answering.communicate()


if "MIDSTRIDE_ROS2_ON_PATHS" in os.environ:  # a test of the second suite alone

    @pytest.mark.ros2
    def test_the_second_ros_2_is_only_on_the_paths() -> None:
        import rclpy

        assert not Path(rclpy.__file__).is_relative_to(sys.prefix)
        assert Path(rclpy.__file__).is_relative_to(os.environ["AMENT_PREFIX_PATH"])
        assert "_ROS_WHEELS_BOOTSTRAP_COMPLETE" not in os.environ
        in_site_packages = importlib.metadata.distributions(
            path=[path for path in sys.path if path.startswith(sys.prefix)]
        )
        assert not [found.name for found in in_site_packages if found.name.startswith("ros-")]
        assert os.environ["ROS_DISTRO"] == "kilted"
        assert hasattr(rclpy, "ok")
