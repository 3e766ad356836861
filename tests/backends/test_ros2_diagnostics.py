"""``/diagnostics`` on real ROS 2, as any tool that subscribes to it sees them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

from midstride.backends.ros2.component.diagnostics_publisher import DiagnosticsPublisher
from midstride.wire.commands import AnswerCommand, SetParametersCommand
from tests.backends.ros2_support import Bare, Rig, rig, run

pytestmark = pytest.mark.ros2

TALKER = """
from midstride import Component
from std_msgs.msg import String

comp = Component("talker")
out = comp.create_output("out", String)
talk = comp.create_functionality("talk", outputs=[out])
every = comp.parameter("every", 1, on_change=int)
calls = 0

def normal():
    global calls
    calls += 1
    if calls % every.value == 0:
        out.write(String(data=str(calls)))

talk.set_normal_mode(normal, rate=10, outputs=[out])
talk.set_degraded_mode(lambda: None)
comp.start()
"""


class Monitor:
    """Subscribes as rqt does, and keeps the last status of each name."""

    def __init__(self, bare: Bare) -> None:
        from diagnostic_msgs.msg import DiagnosticArray

        self.statuses: dict[str, Any] = {}
        self.stamped = True
        self._subscription = bare.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_array, 10)

    def _on_array(self, array: Any) -> None:
        self.stamped = self.stamped and array.header.stamp.sec > 0
        self.statuses |= {status.name: status for status in array.status}

    def shows(self, name: str, level: bytes, words: str = "") -> bool:
        status = self.statuses.get(name)
        return status is not None and status.level == level and words in status.message


def test_a_middleware_that_does_not_return_is_not_asked_again_and_again() -> None:
    """For weeks, each second: the executor would keep them all."""
    pytest.importorskip("diagnostic_msgs")
    tasks: list[Callable[[], object]] = []
    executor, node = Mock(), Mock()
    executor.create_task = lambda function, *arguments: tasks.append(partial(function, *arguments))
    publisher = DiagnosticsPublisher(node, executor, "/talker", "/talker")
    for second in range(3):
        publisher.publish(list, second)
    [task] = tasks
    node.create_publisher.return_value.publish.side_effect = RuntimeError("error not set")
    with pytest.raises(RuntimeError):
        task()
    publisher.publish(list, 3)
    assert len(tasks) == 2, "one that fails is not the last one"


@pytest.mark.full
def test_a_slow_publisher_is_a_warning_under_the_name_that_its_replacement_takes_over(tmp_path: Path) -> None:
    pytest.importorskip("diagnostic_msgs")
    from diagnostic_msgs.msg import DiagnosticStatus

    async def scenario(r: Rig, bare: Bare) -> None:
        monitor, name = Monitor(bare), "talker: out on /talk"
        await r.start("talker", TALKER, node="talker")
        await r.attach("talker", "out", "/talk")
        await r.modes("talker", talk="normal")
        await bare.until(lambda: monitor.shows(name, DiagnosticStatus.OK, "as declared"), 60.0)
        assert monitor.statuses[name].hardware_id == "talker"
        assert "talker: component" in monitor.statuses

        await r.client.change("talker", SetParametersCommand(parameters={"every": 5}))
        await bare.until(lambda: monitor.shows(name, DiagnosticStatus.WARN, "10 Hz declared"), 60.0)
        values = {each.key: each.value for each in monitor.statuses[name].values}
        assert values["Declared frequency (Hz)"] == "10"
        assert float(values["Actual frequency (Hz)"]) < 9

        # It is no endpoint of the component's node, and the back end's graph does not show it.
        shown = bare.node.get_publishers_info_by_topic("/diagnostics")
        assert [info.node_name.startswith("_") for info in shown] == [True]
        assert await r.shows_no_writer("/diagnostics")

        # The replacement shows nothing until it answers for the node; then the old one shows nothing.
        _, registration = await r.start("talker_2", TALKER, node="talker", standby=True)
        assert registration.endpoints == []
        await r.attach("talker_2", "out", "/talk", gate="closed")
        await r.modes("talker_2", talk="normal")
        await r.client.change("talker_2", AnswerCommand(peer="talker", address=r.client.address("talker")))
        await bare.until(lambda: monitor.statuses[name].hardware_id == "talker_2", 60.0)
        assert monitor.shows(name, DiagnosticStatus.OK, "gate is closed")
        assert {status.partition(":")[0] for status in monitor.statuses} == {"talker"}
        assert monitor.stamped

    async def opened() -> None:
        async with rig(tmp_path) as r:
            with Bare() as bare:
                await scenario(r, bare)

    run(opened(), 240.0)
