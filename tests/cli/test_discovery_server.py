"""A robot whose processes find each other by a discovery server of Fast DDS, not by announcements to everybody."""

from __future__ import annotations

import contextlib
import json
import os
import re
import socket
import subprocess
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from midstride.codec.specification_form import encode_specification
from tests.acceptance.support import Recorder, ended, swap_specification
from tests.backends.ros2_support import without_midstride
from tests.cli.conftest import Midstride

pytestmark = [pytest.mark.ros2, pytest.mark.fast_dds, pytest.mark.full]


@contextlib.contextmanager
def discovery_server() -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """The server's address as ``ROS_DISCOVERY_SERVER`` has it, and its process; it is the one of this Fast DDS."""
    from midstride.backends.ros2 import dds_profiles

    dds_profiles.of_this_process()  # loads the middleware
    major = dds_profiles.loaded_major()
    assert major is not None
    libraries = set(re.findall(r"(/\S+)/[^/\s]+\.so\S*$", Path("/proc/self/maps").read_text(), re.MULTILINE))
    (program,) = {path for each in libraries if (path := Path(each).parent / "bin" / "fast-discovery-server").exists()}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    # The program of Fast DDS 3 has commands by number; 42 is the one that serves.
    command = [str(program), *(["42"] if major >= 3 else []), "-i", "0", "-l", "127.0.0.1", "-p", str(port)]
    environment = {**without_midstride(), "LD_LIBRARY_PATH": os.pathsep.join(sorted(libraries))}
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, start_new_session=True) as server:
        try:
            assert server.stdout is not None and b"Server" in server.stdout.readline()
            yield f"127.0.0.1:{port}", server
        finally:
            server.kill()


def test_no_message_is_lost_where_nodes_find_each_other_by_a_discovery_server(
    midstride: Midstride, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A reader outside, too, hears each new publisher from its first message. Without the server a new node finds
    nobody: the change is rolled back, and nodes that are connected already go on communicating.

    Fast DDS keeps the server for all that a process does afterwards, so the process of the tests has no part in it.
    """
    file = tmp_path / "swap.json"
    file.write_text(json.dumps(encode_specification(swap_specification())))
    with ended(), discovery_server() as (address, server):
        monkeypatch.setenv("ROS_DISCOVERY_SERVER", address)
        midstride.environment["ROS_DISCOVERY_SERVER"] = address
        up = midstride("up", str(file), "-d")
        assert up.status == 0, up.err
        recorder = Recorder(tmp_path)
        recorder.wait_until_it_hears()
        outcomes = [
            midstride("replace", "source", component, "--yes", "--json").json for component in ("OtherSource", "Source")
        ]
        server.kill()
        server.wait()
        outcomes.append(midstride("replace", "source", "OtherSource", "--yes", "--json").json)
        rows = recorder.stop()
        assert midstride("down").status == 0
    assert [outcome["outcome"] for outcome in outcomes] == ["done", "done", "rolled_back"], outcomes
    assert "only 0 of 1 endpoints on /swap were found" in outcomes[-1]["because"]
    assert [swap["lost"] for outcome in outcomes for swap in outcome["swaps"]] == [0, 0, 0]
    numbers = [row.number for row in rows]
    begins = [number for before, number in pairwise(numbers) if before is None or number != before + 1]
    assert begins == [1, 1]  # of the two publishers that replaced another; nothing else is out of sequence
