"""The examples, the README and the ROS 1 page of the documentation on real ROS 1."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from midstride.backends.ros1.launching import LOOPBACK
from tests.backends.ros1_support import own_master_uri, program

pytestmark = pytest.mark.ros1

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "how-to" / "ros1.md"


@pytest.mark.parametrize(
    "name", ["talker", *(pytest.param(name, marks=pytest.mark.full) for name in ("obstacle", "filter"))]
)
def test_an_example_runs_and_leaves_nothing_behind(name: str, tmp_path: Path) -> None:
    environment = {**os.environ, "XDG_RUNTIME_DIR": str(tmp_path)}
    environment.pop("ROS_MASTER_URI", None)
    command = [sys.executable, "-m", "midstride", "demo", name, "--backend", "ros1", "--json"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=110, check=False)
    assert done.returncode == 0, done.stderr + done.stdout
    told: dict[str, Any] = json.loads(done.stdout)
    assert (told["backend"], told["outcome"]) == ("ros1", "done")
    for act in told["acts"]:
        assert act["outcome"] == "done"
        if act["plan"]["strategy"] == "minimal":
            for swap in act["swaps"]:
                assert swap["lost"] == 0, swap
                assert None not in swap.values(), swap  # ROS 1 tells all of it between Midstride's own
    marked = [path for path in Path("/proc").glob("[0-9]*/environ") if _mentions(path, str(tmp_path))]
    assert marked == []


def _mentions(environ: Path, text: str) -> bool:
    try:
        return f"XDG_RUNTIME_DIR={text}".encode() in environ.read_bytes().split(b"\0")
    except OSError:
        return False


@pytest.mark.full
def test_the_readme_runs_on_ros_1() -> None:
    from tests.docs.test_snippets import play

    with own_master_uri() as uri:
        play(ROOT / "README.md", "ros1")
        with pytest.raises(OSError, match="refused"):
            _connect(uri)


def _connect(uri: str) -> None:
    import socket

    socket.create_connection((LOOPBACK, int(uri.rpartition(":")[2])), timeout=5).close()


@pytest.mark.full
def test_the_tutorial_can_be_done_on_ros_1(tmp_path: Path) -> None:
    from tests.docs.test_tutorial import play

    with own_master_uri():
        play(tmp_path, "ros1")


# -- the side by side of docs/how-to/ros1.md -----------------------------------------------------------------------


def written() -> dict[str, str]:
    """The programs on the page."""
    found = re.findall(r"^```python file=(\S+)\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    return dict(found)


@contextlib.contextmanager
def master() -> Iterator[None]:
    with own_master_uri() as uri:
        code = "import sys, rosmaster; rosmaster.rosmaster_main(sys.argv)"
        with program("--core", "-p", uri.rpartition(":")[2], source=code):
            deadline = time.monotonic() + 20
            while True:
                try:
                    _connect(uri)
                    break
                except OSError:
                    assert time.monotonic() < deadline
                    time.sleep(0.02)
            yield


@contextlib.contextmanager
def running(folder: Path, file: str, *arguments: str) -> Iterator[Path]:
    """A program of the page; what it prints."""
    printed = folder / f"{file}.out"
    with printed.open("w") as out:
        process = subprocess.Popen(
            [sys.executable, "-u", file, *arguments], cwd=folder, stdout=out, stderr=subprocess.STDOUT
        )
    try:
        yield printed
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(timeout=20)


@pytest.mark.parametrize("talker", ["bare_talker.py", "talker.py"])
@pytest.mark.parametrize("listener", ["bare_listener.py", "listener.py"])
def test_old_and_new_talk_to_each_other(talker: str, listener: str, tmp_path: Path) -> None:
    for name, text in written().items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    alone = {"talker.py": ("--standalone", "out:=/chatter"), "listener.py": ("--standalone", "in:=/chatter")}
    with (
        master(),
        running(tmp_path, talker, *alone.get(talker, ())),
        running(tmp_path, listener, *alone.get(listener, ())) as printed,
    ):
        deadline = time.monotonic() + 30
        while printed.read_text().count("I heard: hello world") < 5:
            assert time.monotonic() < deadline, printed.read_text()
            time.sleep(0.02)


def test_the_page_counts_its_lines_right() -> None:
    programs = {name: len([line for line in text.splitlines() if line]) for name, text in written().items()}
    row = next(
        line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| lines of the talker")
    )
    assert [int(cell) for cell in re.findall(r"\d+", row)] == [programs["bare_talker.py"], programs["talker.py"]]
