"""The graph as the manager's node sees it."""

from __future__ import annotations

from contextlib import ExitStack

import pytest

from tests.backends.ros2_support import Bare, run

pytestmark = pytest.mark.ros2


def test_the_endpoints_of_every_node_of_a_name_are_found() -> None:
    """A node that has ended stays for a while, beside its replacement. What rclpy lists by name is of one of them."""
    from std_msgs.msg import String

    from midstride.backends.ros2.graph import Graph

    async def scenario() -> None:
        with ExitStack() as nodes:
            watching = nodes.enter_context(Bare("watching"))
            for topic in ("/old", "/new"):
                talker = nodes.enter_context(Bare("talker"))
                talker.node.create_publisher(String, topic, 10)
                talker.node.create_subscription(String, f"{topic}/answers", lambda _: None, 10)
            graph = Graph(watching.node)
            expected = {(True, "/old"), (True, "/new"), (False, "/old/answers"), (False, "/new/answers")}

            def found() -> bool:
                return {(each.output, each.topic) for each in graph.of_process("/talker")} >= expected

            await watching.until(found)
            assert graph.of_process("/no_such_node") == []

    run(scenario())
