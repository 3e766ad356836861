"""Real ROS 1 for tests: a master of the test's own, a back end, components from a few lines of source.

Nothing here imports ROS at the top, so that the tests can be collected where there is none.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
import uuid
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

from midstride.runtime import reaper
from midstride.runtime.reaper import Reaper
from midstride.wire.environment import ENV_TOKEN
from tests.backends.ros2_support import Rig

BARE = """
import sys, rospy
from std_msgs.msg import String
rospy.init_node(sys.argv[1])
heard = open(sys.argv[3], "a", buffering=1)
rospy.Subscriber(sys.argv[2], String, lambda message: heard.write(message.data + chr(10)), tcp_nodelay=True)
rospy.spin()
"""


def free_port() -> int:
    with socket.socket() as door:
        door.bind(("127.0.0.1", 0))
        port: int = door.getsockname()[1]
        return port


@contextlib.contextmanager
def own_master_uri() -> Iterator[str]:
    """An address for a master of the test's own; none runs there yet."""
    before = {name: os.environ.get(name) for name in ("ROS_MASTER_URI", "ROS_IP")}
    os.environ["ROS_MASTER_URI"] = uri = f"http://127.0.0.1:{free_port()}"
    os.environ["ROS_IP"] = "127.0.0.1"
    try:
        yield uri
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextlib.asynccontextmanager
async def rig(folder: Path, **options: Any) -> AsyncIterator[Rig]:
    """A back end, opened; at the end it is closed, and everything it started is ended, its master included."""
    from midstride.backends.ros1 import create_backend

    token = f"test-{uuid.uuid4().hex}"
    with own_master_uri(), Reaper(ENV_TOKEN, token) as guarding:
        backend = create_backend(logs=folder / "logs", guardian=guarding, **options)
        rig = Rig(backend, folder, token)
        await backend.open(rig.heard)
        try:
            yield rig
        finally:
            for instance in list(rig.handles):
                await backend.end(instance, 2.0)
            await backend.close()
            assert await backend._master.process() is None, "the master was left running"
    assert reaper.remaining_groups({}, ENV_TOKEN, token) == set()


@contextlib.contextmanager
def program(*arguments: str, source: str = BARE) -> Iterator[subprocess.Popen[bytes]]:
    """A bare program of rospy's, that knows nothing of Midstride; killed at the end."""
    process = subprocess.Popen([sys.executable, "-c", source, *arguments], start_new_session=True)
    try:
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def wait_for(path: Path, lines: int, seconds: float = 20.0) -> list[str]:
    """The lines of a file, once there are so many."""
    deadline = time.monotonic() + seconds
    while True:
        found = path.read_text().splitlines() if path.exists() else []
        if len(found) >= lines:
            return found
        assert time.monotonic() < deadline, f"only {len(found)} of {lines} lines came"
        time.sleep(0.01)
