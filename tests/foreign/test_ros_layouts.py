"""The structures that the library of the gate declares itself: it is compiled without a header of ROS, one for all.

They are compared with those of the installed ROS; docs/reference/distributions.md says what was read of the others.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.backends.ros_usage import GATE
from tests.native import compile_with_ros


@pytest.mark.ros2
def test_the_structures_that_the_library_declares_are_those_of_the_installed_headers(tmp_path: Path) -> None:
    compile_with_ros([Path(__file__).with_name("layouts.c")], tmp_path / "layouts", options=[f"-I{GATE}"])
