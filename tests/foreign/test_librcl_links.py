"""Functions of librcl that the library wraps, and that librcl also calls itself.

Such a call reaches the library only where librcl is linked without ``-Bsymbolic-functions``. Packages for Ubuntu are
linked with it, so nothing may depend on whether these are seen.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from typing import Final

import pytest

pytestmark = pytest.mark.skipif(shutil.which("readelf") is None, reason="binutils are not installed")

# Why it makes no difference, for each call within a library of ROS, whether it is seen.
INDIFFERENT: Final = {
    "rcl_publish": "of /rosout, and of events of services, which have no port",
    "rcl_publisher_init": "the same",
    "rcl_publisher_fini": "the same",
    "rcl_service_init": "by rcl_node_type_description_service_init, which is wrapped as well",
    "rcl_take_request_with_info": "by rcl_take_request, for which the library calls it in its place",
    "rcl_take_response_with_info": "by rcl_take_response, which is wrapped as well, and does the same",
    "rcl_timer_call_with_info": "by rcl_timer_call, which is wrapped as well, and does the same",
    "rcl_timer_init2": "by rcl_timer_init, which is wrapped as well, and does the same",
    "rcl_wait": "while a program waits for publishers or subscriptions to be there",
    "_ZN6rclcpp13PublisherBase19setup_intra_processEmSt10shared_ptrINS_12experimental19IntraProcessManagerEE": (
        "of /parameter_events, which has no port; of others, a template calls it in the library of the program"
    ),
}
LIBRARIES: Final = ("librcl.so", "librcl_action.so", "librcl_lifecycle.so", "librclcpp.so", "librclcpp_action.so")


def own_calls(path: Path) -> set[str]:
    """The functions that a library both has and calls so that another one could come before it."""
    relocations = subprocess.run(["readelf", "-Wr", path], check=True, capture_output=True, text=True).stdout
    called = {words[4] for line in relocations.splitlines() if len(words := line.split()) > 4}
    return called & exported(path)


def exported(path: Path) -> set[str]:
    shown = subprocess.run(["nm", "-D", "--defined-only", path], check=True, capture_output=True, text=True).stdout
    return {line.split()[-1].partition("@")[0] for line in shown.splitlines()}


def installed() -> list[Path]:
    """The libraries of ROS that this process would load."""
    folders = [Path(each) for each in os.environ.get("LD_LIBRARY_PATH", "").split(":") if each]
    return [path for name in LIBRARIES if (path := next((f / name for f in folders if (f / name).exists()), None))]


@pytest.mark.ros2
def test_nothing_depends_on_calls_that_librcl_makes_itself(gate_library: Path) -> None:
    import rclpy  # noqa: F401 - where ROS is not sourced, this puts its folders on the path of libraries

    libraries = installed()
    assert libraries and libraries[0].name == "librcl.so"
    found = set().union(*map(own_calls, libraries)) & exported(gate_library)
    assert found <= INDIFFERENT.keys(), "its wrapper is not called with ROS from packages for Ubuntu"


def test_calls_within_a_library_are_found(programs: Path, packaged_programs: Path) -> None:
    found = own_calls(programs / "librcl.so")
    assert {"rcl_remap_node_name", "rcl_timer_init2"} <= found
    assert not own_calls(packaged_programs / "librcl.so") & found
