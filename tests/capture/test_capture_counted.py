"""What a node publishes within its process is measured without a subscription, where the library is in its process."""

from __future__ import annotations

import os
import subprocess
import time
from pathlib import Path

import pytest

from midstride.backends.ros2.manager.seen_nodes import SeenNodes
from midstride.backends.ros2.manager.seen_writes import SeenWrites
from midstride.capture.observed import ObservedGraph
from midstride.capture.rates import measured
from midstride.codec.component_form import NamedComponentForm
from midstride.foreign.gates import Gates
from midstride.foreign.page import PAGE, Page
from midstride.foreign.record import ForeignRecord
from midstride.model.component import ComponentSpec
from tests.backends.ros2_support import Bare
from tests.foreign.lab import until
from tests.native import compiled, environment_of_compiled

SOURCE = Path(__file__).parents[1] / "foreign" / "within.c"
# As `midstride import` writes it: without ports.
THING = ComponentSpec.of("Thing", run="node", gate="preload")


@pytest.mark.ros2
@pytest.mark.full
def test_no_subscription_is_made_where_the_library_counts(
    tmp_path: Path, gate_library: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from midstride.backends import ros2
    from midstride.backends.ros2.manager import observer

    monkeypatch.setenv("XDG_CACHE_HOME", str(gate_library.parent.parent))
    page = Page(tmp_path / PAGE, gate_library)
    index = page.allocate("within")
    Gates(page, index, THING).prepare({})
    program = compiled(tmp_path, SOURCE, "within", besides=["tracetools"])
    base = environment_of_compiled(os.environ)
    counting = {
        "LD_PRELOAD": str(gate_library),
        "MIDSTRIDE_GATE_PAGE": str(page.path),
        "MIDSTRIDE_GATE_NODE": str(index),
    }
    command = [str(program), "20000000"]
    counted = subprocess.Popen([*command, "/counted", "1000"], env={**base, **counting})
    plain = subprocess.Popen([*command, "/plain", "1000", "--ros-args", "-r", "__node:=plain"], env=base)
    try:
        ForeignRecord(
            instance="within",
            node="/within",
            token="",
            uuid="",
            pid=counted.pid,
            started=time.time_ns(),
            declaration=NamedComponentForm.of(THING),
            index=index,
            topics={},
            modes={},
        ).write(tmp_path)
        with Bare() as bare:

            def nodes() -> list[str]:
                found = map(bare.node.get_publishers_info_by_topic, ("/counted", "/plain"))
                return [info.node_name for among in found for info in among]

            until(lambda: nodes() == ["within", "plain"], "they are not in the graph")
            at_once = ObservedGraph()
            observer._look(bare.node, at_once, SeenWrites(SeenNodes(tmp_path)))
        assert at_once.subscribed == {"/plain"}, "the graph showed them before the first look at the counts"
        graph = ros2.observe(2.0, ("/within", "/plain"), tmp_path)
        (port,) = page.ports(index)
        assert (port.topic, int(port.passed)) == (b"/counted", 0), "it was subscribed to"
        assert int(port.written) == int(port.inside) > 50
    finally:
        for process in (counted, plain):
            process.kill()
            process.wait()
    assert graph.subscribed == {"/plain"}
    assert set(graph.counted) == {("/within", "/counted")}
    rates = {}
    for topic in ("/counted", "/plain"):
        (publisher,) = graph.publishers(topic)
        rate = measured(graph.times(publisher) or [])
        assert rate is not None
        rates[topic] = rate
        assert publisher.process
    assert rates["/counted"].median == pytest.approx(0.02, rel=0.2)
    assert len({graph.publishers(topic)[0].process for topic in rates}) == 2
