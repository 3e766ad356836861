"""Whether the process of a publisher has ended, by `/proc`: without ROS, of processes as the middleware names them."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import pytest

from midstride.backends.ros2.manager import node_owner, publisher_processes
from midstride.backends.ros2.manager.publisher_processes import PublisherProcesses
from midstride.backends.ros2.middleware import PIDS, NodeProcess, of_identifier

HERE = b"here"


def endpoint(pid: int, host: bytes = HERE) -> Any:
    """An endpoint of the graph, whose identity has the host and the number of its process, as Fast DDS's have."""
    return SimpleNamespace(endpoint_gid=host + (pid % PIDS).to_bytes(2, "little") + b"rrrrpppp")


def watched(rmw: str = "rmw_fastrtps_cpp") -> PublisherProcesses:
    own = NodeProcess(b"manager", HERE, os.getpid() % PIDS)
    graph: Any = SimpleNamespace(own_name="/_manager", processes=lambda: [("/_manager", own)], rmw=of_identifier(rmw))
    return PublisherProcesses(graph)


@contextmanager
def program() -> Iterator[subprocess.Popen[bytes]]:
    with subprocess.Popen(["sleep", "600"]) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.fixture(autouse=True)
def _every_process_has_the_middleware(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(node_owner, "_has_fast_dds", lambda pid: True)


def test_a_publisher_is_gone_when_its_process_has_ended() -> None:
    processes = watched()
    with program() as killed, program() as other:
        infos = [endpoint(killed.pid), endpoint(other.pid)]
        assert processes.living(infos) == infos
        killed.kill()
        killed.wait()
        assert processes.living(infos) == infos[1:]


def test_what_is_not_known_is_as_the_graph_shows_it(monkeypatch: pytest.MonkeyPatch) -> None:
    cyclone = watched("rmw_cyclonedds_cpp")
    elsewhere, foreign, ambiguous = watched(), watched(), watched()
    with program() as killed:
        here, there = [endpoint(killed.pid)], [endpoint(killed.pid, b"next")]
        assert cyclone.living(here) == here and elsewhere.living(there) == there
        with monkeypatch.context() as patched:  # another user's
            patched.setattr(node_owner, "_has_fast_dds", lambda pid: False)
            assert foreign.living(here) == here
        with monkeypatch.context() as patched:  # two whose numbers have the same low bits
            patched.setattr(publisher_processes, "pids_of", lambda process, here: [killed.pid, os.getpid()])
            assert ambiguous.living(here) == here
        killed.kill()
        killed.wait()
        for processes, infos in ((cyclone, here), (elsewhere, there), (foreign, here), (ambiguous, here)):
            assert processes.living(infos) == infos


def test_what_had_ended_before_it_was_seen_is_not_known() -> None:
    with program() as killed:
        pass
    assert watched().living([endpoint(killed.pid)]) == [endpoint(killed.pid)]
