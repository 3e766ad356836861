"""Real ROS 1 for tests: a master of the test's own, a back end, components from a few lines of source.

Nothing here imports ROS at the top, so that the tests can be collected where there is none.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import socket
import struct
import subprocess
import sys
import time
import uuid
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

from midstride.backends.ros1 import rpc
from midstride.model.component import StopTimes
from midstride.runtime.process import reaper
from midstride.runtime.process.reaper import Reaper
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
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        port: int = listening.getsockname()[1]
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
async def rig(folder: Path) -> AsyncIterator[Rig]:
    """A back end, opened; at the end it is closed, and everything it started is ended, its master included."""
    from midstride.backends.ros1 import create_backend

    token = f"test-{uuid.uuid4().hex}"
    with own_master_uri(), Reaper(ENV_TOKEN, token) as guarding:
        backend = create_backend(folder / "components", logs=folder / "logs", guardian=guarding)
        rig = Rig(backend, folder, token)
        await backend.open(rig.exits.append)
        try:
            yield rig
        finally:
            rig.client.close()
            for instance in list(rig.handles):
                await backend.end(instance, StopTimes(0.0, 2.0))
            await backend.close()
            assert await backend._master.process() is None, "the master was left running"
    assert reaper.remaining_groups({}, ENV_TOKEN, token) == set()


@contextlib.contextmanager
def program(*arguments: str, source: str = BARE, output: Path | None = None) -> Iterator[subprocess.Popen[bytes]]:
    """A program started by hand, by default a bare subscriber of rospy's; killed at the end."""
    command = [sys.executable, "-u", "-c", source, *arguments]
    with contextlib.nullcontext() if output is None else output.open("w") as out:
        process = subprocess.Popen(command, start_new_session=True, stdout=out, stderr=out)
    try:
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def wait_for(path: Path, lines: int, seconds: float = 90.0) -> list[str]:
    """The lines of a file, once there are so many."""
    deadline = time.monotonic() + seconds
    while True:
        found = path.read_text().splitlines() if path.exists() else []
        if len(found) >= lines:
            return found
        assert time.monotonic() < deadline, f"only {len(found)} of {lines} lines came"
        time.sleep(0.01)


# -- a connection to a publisher, made by hand (TCPROS) ------------------------------------------------------------


def pack_string(text: str) -> bytes:
    """A string as ROS 1 serialises it, and a message of one string."""
    return struct.pack("<I", len(text.encode())) + text.encode()


async def read_block(reader: asyncio.StreamReader) -> bytes:
    """A length, and as many bytes."""
    (length,) = struct.unpack("<I", await reader.readexactly(4))
    return await reader.readexactly(length)


async def subscribe(
    r: Rig, node: str, topic: str, definition: str
) -> tuple[dict[str, str], asyncio.StreamReader, asyncio.StreamWriter]:
    """The header with which the publisher answers, and the connection."""
    uri = await r.backend._master.address_of(node)
    _, _, (_, host, port) = await rpc.call(uri, "requestTopic", "/by_hand", topic, [["TCPROS"]])
    reader, writer = await asyncio.open_connection(host, port)
    asked = {"callerid": "/by_hand", "topic": topic, "md5sum": "*", "message_definition": definition}
    packed = b"".join(pack_string(f"{name}={value}") for name, value in asked.items())
    writer.write(struct.pack("<I", len(packed)) + packed)
    block, answered = await read_block(reader), {}
    while block:
        (length,) = struct.unpack_from("<I", block)
        name, _, value = block[4 : 4 + length].decode().partition("=")
        answered[name], block = value, block[4 + length :]
    assert "error" not in answered, answered
    return answered, reader, writer
