"""The parameters of a component's own node, as its control thread reads them."""

from __future__ import annotations

from unittest.mock import Mock

import pytest

pytestmark = pytest.mark.ros2


def test_a_parameter_may_be_undeclared_while_it_is_reported() -> None:
    """By the author's code, on the other thread: the next report is not to be the last one."""
    from rclpy.exceptions import ParameterNotDeclaredException

    from midstride.backends.ros2.component.data_node import NodeParameter

    node = Mock()
    node.get_parameter.return_value.value = 3
    gains = [NodeParameter(node, "gain", 2, set_from_outside) for set_from_outside in (False, True)]
    assert [(gain.value, gain.declared) for gain in gains] == [(3, 3), (3, 2)]
    node.get_parameter.side_effect = ParameterNotDeclaredException(["gain"])
    assert [(gain.value, gain.declared) for gain in gains] == [(None, None), (None, 2)]
