"""What all tests share: ROS's environment, the markers that depend on the machine, hypothesis's profiles.

A test that needs ROS is marked ``ros2`` or ``ros1`` and imports it inside the test (or a fixture), so that it can be
collected where there is none. There it is skipped, with the reason; not so where ``MIDSTRIDE_NEEDS_ROS2`` says that
ROS 2 is part of the environment: then it runs, and fails. So it is with tests marked ``alloy``, which need the Alloy
Analyzer and Java (``MIDSTRIDE_NEEDS_ALLOY``).
"""

from __future__ import annotations

import importlib.util
import os
import socket
import tempfile

import pytest
from hypothesis import HealthCheck, settings


def _claimed_domain() -> int:
    """A ROS domain that no other test process on this machine has, until this one ends.

    Domains above 101 would take ports that the system hands out to others.
    """
    claim = socket.socket(socket.AF_UNIX)
    for number in range(os.getpid(), os.getpid() + 100):  # another one each time: what was killed lingers for a while
        domain = 1 + number % 100
        try:
            claim.bind(f"\0midstride-test-domain-{domain}")  # in no folder: it goes with its process, however that ends
        except OSError:
            continue
        claim.detach()  # stays open
        return domain
    raise RuntimeError("every ROS domain is taken by another test process")


# Before any test imports ROS, and for the processes that tests start: a network of our own, on this machine alone, and
# no files in the home folder. Tests that run side by side, in one run or in two, do not see each other.
os.environ["ROS_DOMAIN_ID"] = str(_claimed_domain())
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
os.environ.setdefault("ROS_LOG_DIR", os.path.join(tempfile.gettempdir(), "midstride-ros-log"))

# A deadline per example would fail on a busy machine; pytest's time-out bounds each test instead.
# The same examples in each run; the long one looks for new ones.
settings.register_profile("default", deadline=None, print_blob=True, derandomize=True)
settings.register_profile(
    "long",
    settings.get_profile("default"),
    derandomize=False,
    max_examples=2000,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "default"))

_NEEDS = {"ros2": "rclpy", "ros1": "rospy"}

# What ROS's own Python warns of when it is imported is not ours to mend.
_NOT_OURS = ("ignore:module 'sre_:DeprecationWarning", "ignore:.*pkg_resources.*:UserWarning")


def _demanded(marker: str) -> bool:
    return bool(os.environ.get(f"MIDSTRIDE_NEEDS_{marker.upper()}"))


def _missing(marker: str) -> bool:
    """Whether tests of this marker cannot run here, and need not."""
    return not _demanded(marker) and importlib.util.find_spec(_NEEDS[marker]) is None


def _no_alloy() -> str | None:
    """Why tests that need Alloy cannot run here, and need not."""
    from midstride.errors import AlloyMissing
    from midstride.verify.run import find

    if not _demanded("alloy"):
        try:
            find()
        except AlloyMissing as error:
            return str(error)
    return None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    missing = {marker: _missing(marker) for marker in _NEEDS}
    needing_alloy = [item for item in items if item.get_closest_marker("alloy")]
    if needing_alloy and (because := _no_alloy()) is not None:
        for item in needing_alloy:
            item.add_marker(pytest.mark.skip(reason=because))
    for item in items:
        for marker, module in _NEEDS.items():
            if not item.get_closest_marker(marker):
                continue
            for warning in _NOT_OURS:
                item.add_marker(pytest.mark.filterwarnings(warning))
            if missing[marker]:
                item.add_marker(pytest.mark.skip(reason=f"no {module} can be imported here"))
