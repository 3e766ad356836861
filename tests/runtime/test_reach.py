"""A manager that cannot reach the components which an earlier one has left, as in another ROS domain, says so."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from midstride.backends.simulator import Simulator
from midstride.errors import ManagerError
from midstride.runtime.backend_protocol import Handle
from midstride.runtime.manager import Manager
from midstride.runtime.process.reaper import process_info
from midstride.runtime.records.state_store import StateStore
from midstride.runtime.workspace import Workspace
from tests.runtime.systems import EXAMPLES, example, saved


class Reaching(Simulator):
    """A platform with ROS domains and middlewares."""

    def __init__(self, domain: str, middleware: str = "rmw_fastrtps_cpp") -> None:
        super().__init__()
        self._reach = {"ROS_DOMAIN_ID": domain, "RMW_IMPLEMENTATION": middleware}

    def reach(self) -> dict[str, str]:
        return self._reach


def manager(folder: Path, simulator: Simulator) -> Manager:
    return Manager(example("talker"), simulator, Workspace(folder), EXAMPLES / "talker")


def leave_running(folder: Path, simulator: Simulator) -> None:
    """Bring the system up by a manager, which then ends alone."""

    async def main() -> None:
        first = manager(folder, simulator)
        await first.up()
        await first.close()

    simulator.run(main())


@pytest.mark.parametrize(("domain", "started"), [("150", 0.0), ("151", 1.0)])
def test_nothing_is_adopted_that_could_not_be_reached(domain: str, started: float, tmp_path: Path) -> None:
    """``started``: whether the process of the listener is the one that was started, or another one of its number."""
    leave_running(tmp_path, Reaching("150"))
    found = saved(Workspace(tmp_path))
    assert found.reach == {"ROS_DOMAIN_ID": "150", "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"}
    info = process_info(os.getpid())
    assert info is not None
    store = StateStore(Workspace(tmp_path).state)
    store.take_over()
    [listener] = [each for each in found.instances if each.instance.name == "listener"]
    store.write_instance(listener.instance, Handle("listener", info.pid, info.started + started))
    store.close()
    other = Reaching(domain)

    async def again() -> None:
        await manager(tmp_path, other).up()

    other.run(again())


@pytest.mark.parametrize(
    ("other", "theirs", "this"),
    [
        (Reaching("151"), "ROS_DOMAIN_ID=150", "ROS_DOMAIN_ID=151"),
        (
            Reaching("150", "rmw_cyclonedds_cpp"),
            "RMW_IMPLEMENTATION=rmw_fastrtps_cpp",
            "RMW_IMPLEMENTATION=rmw_cyclonedds_cpp",
        ),
        (
            Reaching("0", "rmw_zenoh_cpp"),
            "ROS_DOMAIN_ID=150, RMW_IMPLEMENTATION=rmw_fastrtps_cpp",
            "ROS_DOMAIN_ID=0, RMW_IMPLEMENTATION=rmw_zenoh_cpp",
        ),
    ],
    ids=["domain", "middleware", "both"],
)
def test_a_manager_that_reaches_elsewhere_refuses_to_begin(
    other: Reaching, theirs: str, this: str, tmp_path: Path
) -> None:
    leave_running(tmp_path, Reaching("150"))
    info = process_info(os.getpid())
    assert info is not None
    store = StateStore(Workspace(tmp_path).state)
    store.take_over()
    for each in saved(Workspace(tmp_path)).instances:
        store.write_instance(each.instance, Handle(each.instance.name, info.pid, info.started))
    store.close()
    before = saved(Workspace(tmp_path)).reach

    async def again() -> None:
        second = manager(tmp_path, other)
        with pytest.raises(ManagerError) as refused:
            await second.up()
        await second.close()
        assert str(refused.value) == (
            f"listener, talker run with {theirs}, and this manager has {this}, so it would not "
            f"reach them: run `midstride up` with {theirs} again, or `midstride down` first"
        )

    other.run(again())
    assert saved(Workspace(tmp_path)).reach == before, "nothing was changed"
