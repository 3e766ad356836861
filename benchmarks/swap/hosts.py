"""The hosts of the comparison: ROS 2 with the middleware settings of `midstride up`, ROS 1 with its stock master."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .streams import PATIENCE, Host, SwapFailed

PROGRAMS = Path(__file__).resolve().parent / "programs"


@contextmanager
def ros2() -> Iterator[Host]:
    """ROS 2 on a domain of this comparison. This process gets the environment, too."""
    from benchmarks._tuned import tuned_environment

    os.environ.setdefault("ROS_DOMAIN_ID", "86")
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.update(tuned_environment(dict(os.environ)))
    yield Host("ros2", sys.executable, PROGRAMS / "nodes.py", dict(os.environ))


@contextmanager
def ros1() -> Iterator[Host | None]:
    """ROS 1 with a master of this comparison; None where there is no ROS 1."""
    from midstride.backends.ros1 import launching

    python = launching.interpreter()
    if python is None:
        yield None
        return
    with socket.create_server(("127.0.0.1", 0)) as door:
        port = door.getsockname()[1]
    uri = os.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{port}"
    env = launching.environment(os.environ, uri)
    with tempfile.TemporaryDirectory() as folder:
        # As `roscore` runs it.
        master = subprocess.Popen(
            [python, "-c", "import sys, rosmaster; rosmaster.rosmaster_main(sys.argv)", "--core", "-p", str(port)],
            env={**env, "ROS_LOG_DIR": folder},
            stdout=subprocess.DEVNULL,
            start_new_session=True,
        )
        try:
            _answers(port)
            yield Host("ros1", python, PROGRAMS / "nodes_ros1.py", env)
        finally:
            master.kill()
            master.wait()


def _answers(port: int) -> None:
    deadline = time.monotonic() + PATIENCE
    while True:
        try:
            socket.create_connection(("127.0.0.1", port), timeout=1).close()
            return
        except OSError as error:
            if time.monotonic() > deadline:
                raise SwapFailed("the ROS master did not start") from error
            time.sleep(0.05)
