"""Whose a node of the graph is, in words: without ROS, of processes as the middleware names them."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from midstride.backends.ros2.manager.node_owner import ELSEWHERE, described, node_owner
from midstride.backends.ros2.middleware import PIDS, NodeProcess, of_identifier
from midstride.backends.ros2.names import InstanceNode, system_tag
from midstride.runtime.process.reaper import environment_value
from midstride.wire.environment import ENV_CONTROL, ENV_INSTANCE, ENV_TOKEN

HERE = b"here"


def owner(rmw: str, *processes: NodeProcess, instance: InstanceNode | None = None) -> str:
    """Whose `/talker` is, which these processes have; the manager is on this computer."""
    own = NodeProcess(b"manager", HERE if "fast" in rmw else None, os.getpid() % PIDS)
    shown = [("/_manager", own), *(("/talker", process) for process in processes)]
    graph: Any = SimpleNamespace(
        own_name="/_manager", processes=lambda: shown, of_name=lambda node: {instance}, rmw=of_identifier(rmw)
    )
    return node_owner(graph, "/talker", Path("/run/own/components"))


@contextmanager
def sleeping(variables: Mapping[str, str]) -> Iterator[int]:
    """A process with these variables that has nothing to do with ROS; its number, once they are to be read."""
    with subprocess.Popen(["sleep", "600"], env={"PATH": os.environ["PATH"], **variables}) as process:
        try:
            command = Path(f"/proc/{process.pid}/cmdline")
            while not command.read_bytes().startswith(b"sleep") or any(
                environment_value(process.pid, name) != value for name, value in variables.items()
            ):
                pass
            yield process.pid
        finally:
            process.kill()


def test_another_computer_is_not_looked_at() -> None:
    assert owner("rmw_fastrtps_cpp", NodeProcess(b"x", b"there", os.getpid() % PIDS)) == ELSEWHERE


def test_a_process_of_that_number_without_the_middleware_is_not_taken_for_it() -> None:
    """In another container, a node's process may have the number of any process here."""
    with sleeping({}) as pid:
        assert owner("rmw_fastrtps_cpp", NodeProcess(b"x", HERE, pid % PIDS)) == ELSEWHERE


def test_where_the_middleware_does_not_tell_processes_it_is_not_known() -> None:
    found = owner("rmw_cyclonedds_cpp", NodeProcess(b"x"))
    assert found == "whose it is, is not known: rmw_cyclonedds_cpp does not tell which process has a node"


@pytest.mark.parametrize("rmw", ["rmw_fastrtps_cpp", "rmw_cyclonedds_cpp"])
def test_a_component_names_its_system_which_may_be_found_here(rmw: str, tmp_path: Path) -> None:
    token, folder = f"token of {tmp_path}", tmp_path / "chat"
    instance = InstanceNode("/talker_3", "/talker", system_tag(token))
    assert owner(rmw, instance=instance) == f"it is talker_3 of another Midstride system; {ELSEWHERE}"
    variables = {ENV_TOKEN: token, ENV_INSTANCE: "talker_3", ENV_CONTROL: str(folder / "components")}
    with sleeping(variables) as pid:
        whole = f"it is talker_3 of the Midstride system chat ({folder}), process {pid}"
        assert owner(rmw, instance=instance) == described(pid) == whole


def test_an_own_instance_of_that_name_is_not_the_owner(tmp_path: Path) -> None:
    token = f"token of {tmp_path}"
    variables = {ENV_TOKEN: token, ENV_INSTANCE: "talker", ENV_CONTROL: "/run/own/components"}
    with sleeping(variables):
        found = owner("rmw_cyclonedds_cpp", instance=InstanceNode("/talker", "/talker", system_tag(token)))
    assert found == "whose it is, is not known: rmw_cyclonedds_cpp does not tell which process has a node"


def test_any_other_process_is_shown_by_its_command_line() -> None:
    with sleeping({}) as pid:
        assert described(pid) == f"it is process {pid} (`sleep 600`)"
