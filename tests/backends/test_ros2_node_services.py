"""What a manager asks of a node without Midstride's API, where rclpy itself fails."""

from __future__ import annotations

import asyncio
from unittest.mock import MagicMock, Mock

import pytest

from midstride.foreign.services import NoAnswer

pytestmark = pytest.mark.ros2


@pytest.mark.parametrize("fails", ["create", "ready", "send", "take"])
def test_what_rclpy_raises_is_no_answer(fails: str) -> None:
    """Those that ask expect that, and go on asking."""
    from midstride.backends.ros2.manager.node_services import RosNodeServices

    error, client, node = RuntimeError("error not set"), MagicMock(), Mock()
    node.create_client = Mock(return_value=client, side_effect=error if fails == "create" else None)
    client.service_is_ready.side_effect = error if fails == "ready" else None
    client.handle.send_request.side_effect = error if fails == "send" else None
    client.handle.take_response.side_effect = error if fails == "take" else None
    with pytest.raises(NoAnswer, match="/camera/get_state cannot be asked: error not set"):
        asyncio.run(RosNodeServices(node, "/camera").lifecycle_state(1.0))


def test_of_two_nodes_of_one_name_no_parameter_is_read() -> None:
    """Either may answer, and the other one's values are not those of the node."""
    from midstride.backends.ros2.manager.node_services import RosNodeServices

    node = Mock()
    node.get_node_names_and_namespaces.return_value = [("talk", "/"), ("talk", "/front"), ("talk", "/")]
    with pytest.raises(NoAnswer, match="more than one node is called /talk"):
        asyncio.run(RosNodeServices(node, "/talk").parameters(1.0))
    node.create_client.assert_not_called()
