"""Nodes of launch files get the parameters on real ROS 2 that ROS's own command line gives them."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from tests.cli.conftest import Midstride

pytestmark = [pytest.mark.ros2, pytest.mark.full]

# Each node says which parameters it has, in a file that is named by the program's first argument and its full name.
# Of two, the inner one has a name and a namespace of its own, as the costmaps of Nav2.
PROGRAM = """
import json, os, sys
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

rclpy.init()
executor = SingleThreadedExecutor()

def node(name, **options):
    made = Node(name, automatically_declare_parameters_from_overrides=True, **options)
    values = {key: each.value for key, each in made.get_parameters_by_prefix("").items()}
    values.pop("start_type_description_service", None)
    name = made.get_fully_qualified_name()[1:].replace("/", ".")
    path = os.path.join(os.environ["SAID"], f"{sys.argv[1]}.{name}.json")
    lists = {key: list(each) for key, each in values.items() if not isinstance(each, (bool, int, float, str))}
    with open(path + ".new", "w") as file:
        json.dump(values | lists, file)
    os.rename(path + ".new", path)
    executor.add_node(made)

node("talk")
if sys.argv[1] in ("two", "pair"):
    node("local_costmap", cli_args=["--ros-args", "-r", "__node:=local_costmap", "-r", "__ns:=/local_costmap"])
try:
    executor.spin()
except BaseException:
    pass
"""

FILES = {
    "r0.yaml": "driver: {ros__parameters: {rate: 20.0}}\n",
    "r2.yaml": "two:\n  ros__parameters: {rate: 20.0}\n"
    "local_costmap:\n  local_costmap:\n    ros__parameters: {rate: 5.0}\n",
    "r1.yaml": "talk: {ros__parameters: {rate: 40.0}}\n/**: {ros__parameters: {all: 1}}\n",
    "r2_unnamed.yaml": "talk:\n  ros__parameters: {rate: 20.0}\n"
    "local_costmap:\n  local_costmap:\n    ros__parameters: {rate: 5.0}\n",
    "twice.yaml": "/**: {ros__parameters: {rate: 10.0}}\n/**: {ros__parameters: {text: second}}\n"
    "twice: {ros__parameters: {rate: 40.0}}\n",
    "nan.yaml": "nan: {ros__parameters: {rate: 40.0, limit: .NAN, most: .inf, all: [-.inf, 1.0]}}\n",
    "tuple.yaml": "tuple: {ros__parameters: {rate: 40.0, names: !!python/tuple [a, b]}}\n",
    "list.yaml": "list:\n  ros__parameters:\n    rate: 40.0\n    map:\n    - inner: [x]\n",
    "names.yaml": "/**:\n  ros__parameters:\n    required:\n      'part: state one': default\n      slash/name: 2\n"
    "      dash-name: 3\n      1st: 4\n",
    "after.yaml": "after: {ros__parameters: {a: 2}}\n/**: {ros__parameters: {a: 1, b: 1}}\n",
    "first.yaml": "/**: {ros__parameters: {a: 1}}\nseveral: {ros__parameters: {a: 2}}\n",
    "second.yaml": "/**: {ros__parameters: {a: 9, b: 9}}\n",
}
NAMED: dict[str, tuple[str, ...]] = {
    name: (f"{name}.yaml",) for name in ("twice", "nan", "tuple", "list", "names", "after")
}
# As launch starts nodes without a name.
UNNAMED = {"alone": "r1.yaml", "pair": "r2_unnamed.yaml"}
NAMED |= {"two": ("r2.yaml",), "several": ("first.yaml", "second.yaml")}


def until(condition: Callable[[], bool], what: str, seconds: float = 30.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.05)


def said(folder: Path) -> dict[str, dict[str, Any]]:
    """By program and node, the parameters that it has said; NaN as a text, since it is equal to nothing."""
    texts = {path.stem: path.read_text() for path in folder.glob("*.json")}
    return {name: json.loads(text, parse_constant=str) for name, text in texts.items()}


def by_hand(folder: Path, started: Sequence[Sequence[str]], nodes: int) -> dict[str, dict[str, Any]]:
    """What the nodes of these commands say."""
    out = folder / "by_hand"
    out.mkdir()
    processes = [
        subprocess.Popen([sys.executable, "program.py", *words], cwd=folder, env={**os.environ, "SAID": str(out)})
        for words in started
    ]
    try:
        until(lambda: len(said(out)) >= nodes, f"{nodes} nodes have not said their parameters: {said(out).keys()}")
    finally:
        for process in processes:
            process.send_signal(signal.SIGKILL)
            process.wait()
    return said(out)


def test_nodes_get_the_parameters_that_ros_gives_them(midstride: Midstride, tmp_path: Path) -> None:
    (tmp_path / "program.py").write_text(PROGRAM)
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    # What launch writes for a `<param>` of a node without a namespace.
    (tmp_path / "inline.yaml").write_text("/**: {ros__parameters: {rate: 40.0}}\n")
    started = [
        ["driver", "--ros-args", "-r", "__node:=driver", "--params-file", "r0.yaml", "--params-file", "inline.yaml"]
    ]
    for name, files in NAMED.items():
        arguments = [word for file in files for word in ("--params-file", file)]
        started.append([name, "--ros-args", "-r", f"__node:={name}", *arguments])
    started += [[name, "--ros-args", "--params-file", file] for name, file in UNNAMED.items()]
    wanted = by_hand(tmp_path, started, len(started) + 2)

    params = {name: "".join(f'<param from="$(dirname)/{file}"/>' for file in files) for name, files in NAMED.items()}
    params["driver"] = '<param from="$(dirname)/r0.yaml"/><param name="rate" value="40.0"/>'
    nodes = "".join(
        f'<node pkg="" exec="{sys.executable}" name="{name}" args="program.py {name}">{each}</node>\n'
        for name, each in params.items()
    )
    nodes += "".join(
        f'<node pkg="" exec="./{name}" args="{name}"><param from="$(dirname)/{file}"/></node>\n'
        for name, file in UNNAMED.items()
    )
    for name in UNNAMED:
        script = tmp_path / name
        script.write_text(f"#!{sys.executable}\n{PROGRAM}")
        script.chmod(0o755)
    (tmp_path / "robot.launch.xml").write_text(f"<launch>\n{nodes}</launch>\n")
    out = tmp_path / "started"
    out.mkdir()
    imported = midstride("import", str(tmp_path / "robot.launch.xml"), "-o", str(tmp_path / "robot.stride"))
    assert imported.status == 0, imported.err
    up = midstride("up", str(tmp_path / "robot.stride"), "--backend", "ros2", "--detach", SAID=str(out))
    assert up.status == 0, up.err
    until(lambda: said(out).keys() >= wanted.keys(), f"not all nodes have said their parameters: {said(out).keys()}")
    assert said(out) == wanted
    assert wanted["two.local_costmap.local_costmap"] == {"use_sim_time": False, "rate": 5.0}
    assert wanted["driver.driver"]["rate"] == 40.0
    kept = sorted((midstride.runtime / "midstride" / "robot").rglob("parameters/*.yaml"))
    assert [path.stem for path in kept] == sorted([*params, *UNNAMED])
    assert wanted["alone.talk"]["rate"] == 40.0 and wanted["pair.talk"]["rate"] == 20.0
    assert wanted["pair.local_costmap.local_costmap"]["rate"] == 5.0
    assert all(path.stat().st_mode & 0o077 == 0 for path in kept)

    # Nothing has changed, whatever is not finite.
    assert "Nothing to do" in midstride("apply", str(tmp_path / "robot.stride"), "--yes").out
    again = {name: wanted[name] for name in ("two.two", "nan.nan", "alone.talk", "two.local_costmap.local_costmap")}
    for name in again:
        (out / f"{name}.json").unlink()
    done = midstride("restart", "two", "nan", "alone", "--yes", "--with-other-nodes")
    assert done.status == 0, done.err
    until(lambda: said(out).keys() >= again.keys(), "the new instances have not said their parameters")
    assert {name: said(out)[name] for name in again} == again
    assert midstride("down").status == 0
    assert not [*(midstride.runtime / "midstride" / "robot").rglob("parameters/*.yaml")]
