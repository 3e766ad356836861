"""Processes with several nodes on real ROS 2: all are found and listed, and none is ended without being meant."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.backends.ros2_support import Bare
from tests.cli.conftest import Midstride

pytestmark = [pytest.mark.ros2, pytest.mark.full]

# In plain rclpy: two nodes, a third in a ROS context of its own, and a fourth in a process that it starts; `box` is a
# stand-in for a container, which loads a component once a file is there.
SEVERAL = """
import subprocess, sys
from pathlib import Path
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from std_msgs.msg import String
from std_srvs.srv import Trigger

kind = sys.argv[1]
rclpy.init()
executor = SingleThreadedExecutor()


def add(name, topic, **options):
    node = rclpy.create_node(name, **options)
    publisher = node.create_publisher(String, topic, 10)
    node.create_timer(0.05, lambda: publisher.publish(String(data=node.get_name())))
    executor.add_node(node)
    return node


first = add(f"{kind}_first", f"/{kind}/said")
if kind != "child":
    second = add(f"{kind}_second", f"/{kind}/other")
if kind == "box":
    context = Context()
    rclpy.init(args=[], context=context)
    third = rclpy.create_node("box_third", context=context)
    child = subprocess.Popen([sys.executable, __file__, "child"])
    wanted = Path(__file__).with_name("load")

    def load():
        if wanted.exists():
            wanted.unlink()
            add("loaded", "/loaded/said", use_global_arguments=False).create_service(Trigger, "/save", lambda *_: None)

    first.create_timer(0.05, load)
try:
    executor.spin()
except BaseException:
    pass
"""

ROBOT = """system several
topic /gated/said : std_msgs/msg/String
topic /relayed/said : std_msgs/msg/String
topic /apart/said : std_msgs/msg/String
component Gated {
  run "python3 several.py gated" gate preload
  output out as /gated/said
  functionality f { produces out mode normal { guarantee out : std_msgs/msg/String } mode degraded { } }
}
component Relayed like Gated { run "python3 several.py relayed" gate relay output out as /relayed/said }
component Apart like Relayed { run "python3 several.py apart" gate relay unnamed output out as /apart/said }
component Part { run "python3 several.py part" gate none renames part_first }
component Misnamed { run "python3 several.py misnamed" gate none renames first }
component Box { run "python3 several.py box" gate none unnamed }
node gated : Gated { out -> /gated/said }
node relayed : Relayed { out -> /relayed/said }
node apart : Apart { out -> /apart/said }
node part : Part
node box : Box
"""


def until(holds: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + 30
    while not holds():
        assert time.monotonic() < deadline, what
        time.sleep(0.1)


def listed(midstride: Midstride, name: str) -> dict[str, Any]:
    [found] = [each for each in midstride("status", "--json").json["instances"] if each["role"] == name]
    return {each["name"]: (each["publishes"], each["serves"]) for each in found["other_nodes"]}


def nodes_that_write(topic: str) -> set[str]:
    """The names of the living nodes that publish there, directly or through a relay."""
    found: set[str] = set()
    with Bare("looker") as bare:

        def look() -> bool:
            topics = [
                name for name, _ in bare.node.get_topic_names_and_types() if name.startswith("/_midstride/relay/")
            ]
            infos = [each for name in (topic, *topics) for each in bare.node.get_publishers_info_by_topic(name)]
            found.update(f"/{each.node_name}" for each in infos if each.node_name.startswith("apart"))
            return len(found) == 2

        until(look, f"{found} write on {topic}")
    return found


def test_every_node_of_a_process_is_listed_and_ended_only_where_it_is_meant(
    midstride: Midstride, tmp_path: Path
) -> None:
    (tmp_path / "several.py").write_text(SEVERAL)
    file = tmp_path / "several.stride"
    file.write_text(ROBOT)
    up = midstride("up", str(file), "-d", timeout=60)
    assert up.status == 0, up.out + up.err
    # Those of the process, of a further ROS context, and of a process that it has started.
    of_box = {"/box_second", "/box_third", "/child_first"}
    until(lambda: listed(midstride, "box").keys() == of_box, str(listed(midstride, "box")))
    until(lambda: listed(midstride, "box")["/box_second"] == (["/box/other"], []), "what it does is not known")
    # The library has the name reach its own node only. Behind a relay it is for all nodes, unless they keep theirs.
    until(lambda: listed(midstride, "gated") == {"/gated_second": (["/gated/other"], [])}, "it has another name")
    until(lambda: listed(midstride, "relayed") == {"/relayed": ([], [])}, str(listed(midstride, "relayed")))
    until(lambda: listed(midstride, "apart") == {"/apart_second": (["/apart/other"], [])}, "it has another name")
    # Where it is stated what the program calls its node, the name is for that one alone.
    until(lambda: listed(midstride, "part") == {"/part_second": (["/part/other"], [])}, "it has another name")
    shown = midstride("status").out
    assert "also node /box_third" in shown and "a second node of this name" in shown, shown
    # Where that is wrong, the name is for none.
    assert midstride("add", "misnamed", "Misnamed", "--yes", timeout=60).status == 0
    wrong = "`renames first` is the name of no node of its process, which has nodes /misnamed_first, /misnamed_second"
    until(lambda: wrong in midstride("status", "--json").json["condition"]["headline"], "it is not named")
    assert midstride("remove", "misnamed", "--yes", "--with-other-nodes", timeout=60).status == 0
    # What others load after the start counts, and is in the refusal at once.
    (tmp_path / "load").touch()
    loaded = (["/loaded/said"], ["service /save"])
    until(lambda: listed(midstride, "box").get("/loaded") == loaded, "nothing was loaded")
    refused = midstride("restart", "box", "--yes")
    names = "/box_second, /box_third, /child_first, /loaded"
    assert refused.status == 1, refused.out
    assert f"the change would also end other nodes of the same process: {names} with box" in refused.out, refused.out
    assert "pass `--with-other-nodes`" in refused.out
    for words in (
        ["remove", "gated", "--yes"],
        ["plan", "--restart", "gated"],
        ["replace", "relayed", "Relayed", "-y"],
    ):
        done = midstride(*words)
        assert done.status == 1 and "of the same process" in done.out + done.err, done.out + done.err
        assert ("state `renames NAME`" in done.out + done.err) == ("relayed" in words), done.out + done.err
    # Where they are meant, plan and report say what becomes of each.
    done = midstride("restart", "box", "gated", "apart", "--yes", "--with-other-nodes", "--json", timeout=60)
    assert done.status == 0, done.out + done.err
    assert done.json["plan"]["continuity"]["verdict"] == "lost"
    found = {each["subject"]: each for each in done.json["continuity"]["found"]}
    assert found["/loaded"]["verdict"] == "lost" and not found["/loaded"]["lasting"]
    assert found["/loaded"]["words"].startswith("node /loaded (publishes on /loaded/said; serves service /save) ended")
    assert found["/gated_second"]["verdict"] == "not_measurable", found["/gated_second"]["words"]
    assert "gated_2 has such a node" in found["/gated_second"]["words"]
    until(lambda: listed(midstride, "gated") == {"/gated_second": (["/gated/other"], [])}, "it has another name")
    until(lambda: listed(midstride, "box").keys() == of_box, str(listed(midstride, "box")))
    # The second instance behind the relay has another name meanwhile, and its further node keeps its own.
    until(lambda: listed(midstride, "apart") == {"/apart_second": (["/apart/other"], [])}, "it has another name")
    assert nodes_that_write("/apart/said") == {"/apart_first_2", "/apart_2_relay"}
    # A crash ends them all, and says so.
    [box] = [each for each in midstride("status", "--json").json["instances"] if each["role"] == "box"]
    os.kill(box["pid"], signal.SIGKILL)
    until(lambda: "with it ended nodes /box_second, /box_third, /child_first" in midstride("log").out, "no word of it")
    assert midstride("down").status == 0
