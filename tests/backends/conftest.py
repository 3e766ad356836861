"""What the tests on real ROS 2 share."""

from __future__ import annotations

import pytest

# What ROS 2's own Python warns of when it is imported is not ours to mend.
_NOT_OURS = ("ignore:module 'sre_:DeprecationWarning", "ignore:.*pkg_resources.*:UserWarning")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.get_closest_marker("ros2"):
            for warning in _NOT_OURS:
                item.add_marker(pytest.mark.filterwarnings(warning))
