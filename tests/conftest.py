"""What all tests share: ROS's environment, the markers that depend on the machine, hypothesis's profiles.

A test that needs ROS is marked ``ros2`` or ``ros1`` and imports it inside the test (or a fixture), so that it can be
collected without ROS. There it is skipped, with the reason. A test of what Fast DDS alone has or tells is marked
``fast_dds`` as well, and is skipped where ``RMW_IMPLEMENTATION`` names another middleware. If ``MIDSTRIDE_NEEDS_ROS2``
is set, ROS 2 is part of the environment: the test runs, and fails without it. The same holds for the markers ``alloy``
(the Alloy Analyzer and Java), ``graphviz``, ``browser`` (Chromium), ``rust`` (what tools/rust builds), ``arm64`` (a
compiler and an emulator), ``ansible`` (what tools/ansible installs), ``hosts`` (network namespaces and an SSH server)
and ``promtool``. tools/test sets these variables for everything that it was able to install.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import signal
import socket
import sys
import tempfile
from functools import cache
from pathlib import Path

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

# In this process and in the managers that tests start, a state that changes as it must not raises.
os.environ["MIDSTRIDE_STRICT_TRANSITIONS"] = "1"

# Files of compiled code are told from older ones by whole seconds, and tests change programs more often than that. The
# tests themselves are compiled to such files until they have been collected.
os.environ["PYTHONDONTWRITEBYTECODE"] = "1"


def pytest_collection_finish() -> None:
    sys.dont_write_bytecode = True


# Processes that tests start are ended with SIGINT as well, which a script's background job ignores, and so do its
# children.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# A deadline per example would fail on a busy machine; pytest's time-out bounds each test instead.
# The same examples in each run, a quarter of them every day; the long one looks for new ones.
settings.register_profile("thorough", deadline=None, print_blob=True, derandomize=True)
settings.register_profile("daily", settings.get_profile("thorough"), max_examples=25)
settings.register_profile(
    "long",
    settings.get_profile("thorough"),
    derandomize=False,
    max_examples=2000,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "daily"))

_MODULES = {"ros2": "rclpy", "ros1": "rospy"}
_MARKERS = (*_MODULES, "fast_dds", "alloy", "graphviz", "browser", "rust", "arm64", "ansible", "hosts", "promtool")

# ROS's own Python modules cause these warnings when they are imported.
_ROS_WARNINGS = ("ignore:module 'sre_:DeprecationWarning", "ignore:.*pkg_resources.*:UserWarning")


@cache
def _unavailable(marker: str) -> str | None:
    """Why tests with this marker are skipped here; None if they run."""
    if marker == "fast_dds":
        middleware = os.environ.get("RMW_IMPLEMENTATION") or "rmw_fastrtps_cpp"
        return (
            None
            if middleware.startswith("rmw_fastrtps")
            else f"about what Fast DDS alone has or tells, and this is {middleware}"
        )
    if os.environ.get(f"MIDSTRIDE_NEEDS_{marker.upper()}"):
        return None
    if marker in _MODULES:
        module = _MODULES[marker]
        return None if importlib.util.find_spec(module) else f"no {module} can be imported here"
    if marker == "graphviz":
        return None if shutil.which("dot") else "Graphviz is not installed"
    if marker == "browser":
        return None if shutil.which("chromium") else "Chromium is not installed"
    if marker == "arm64":
        found = shutil.which("qemu-aarch64") and shutil.which("aarch64-linux-gnu-gcc")
        return None if found else "no emulator of arm64, or no compiler for it, is installed (tools/arm64)"
    if marker == "promtool":
        return None if shutil.which("promtool") else "promtool is not installed (`apt install prometheus`)"
    if marker == "hosts":
        from tests.hosts.two_hosts import missing

        return missing()
    if marker == "rust":
        from tests.native import RUST_TALKER

        return None if RUST_TALKER.exists() else "tools/rust has not built the node in Rust (it says why)"
    if marker == "ansible":
        installed = Path(__file__).parents[1] / ".venv-ansible" / "bin" / "ansible-playbook"
        return None if installed.exists() else "ansible-core is not installed (`make ansible`)"
    from midstride.errors import AlloyMissing
    from midstride.verify.run import find

    try:
        find()
    except AlloyMissing as error:
        return str(error)
    return None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        for marker in _MARKERS:
            if item.get_closest_marker(marker):
                if marker in _MODULES:
                    for warning in _ROS_WARNINGS:
                        item.add_marker(pytest.mark.filterwarnings(warning))
                if reason := _unavailable(marker):
                    item.add_marker(pytest.mark.skip(reason=reason))


@pytest.fixture(scope="session")
def gate_library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The compiled library of the gates, of the sources as they are. Skips where there is no C compiler."""
    from midstride.foreign import build
    from tests.native import c_compiler

    c_compiler()
    return build.library({**os.environ, "XDG_CACHE_HOME": str(tmp_path_factory.mktemp("cache"))})
