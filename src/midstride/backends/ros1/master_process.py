"""The master's process: started where none runs, and ended by the last that needs it if Midstride started it.

Under ``up`` the components outlive their manager, so their master does as well. A master that Midstride started carries
that in its environment, where any later manager finds it.
"""

from __future__ import annotations

import asyncio
import socket
import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from midstride.backends.ros1 import launching, rpc
from midstride.backends.ros1.master import Master
from midstride.errors import BackendError, StartFailed
from midstride.model.component import StopTimes
from midstride.runtime.process.child_process import find, spawn, tail
from midstride.runtime.process.reaper import Reaper, process_info

ENV_STARTED: Final = "MIDSTRIDE_ROS1_MASTER"
# How long a master may take to answer after its start (s).
_START: Final = 10.0
_GRACE: Final = 2.0
_POLL: Final = 0.02
# The stock master notifies subscribers of new publishers from three workers that look for work ten times a second: a
# new publisher is found after 50 to 100 ms, and three frozen subscribers keep all others waiting. These do better.
_PROGRAM: Final = """
import sys
from rosmaster import rosmaster_main, threadpool
threadpool.ThreadPoolThread.threadSleepTime = 0.01
rosmaster_main(sys.argv)
"""
_WORKERS: Final = "16"


def hold(uri: str) -> socket.socket:
    """Mark the master at ``uri`` as needed by this manager, until the socket is closed or this process ends.

    The mark is an abstract Unix socket: it belongs to the network namespace, as a local master's port does.
    """
    mark = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    mark.bind(f"\0{_marks(uri)}{uuid.uuid4().hex}")
    return mark


def _marks(uri: str) -> str:
    """The beginning of the names of all managers' marks."""
    return f"midstride-ros1-master-{rpc.address(uri)[1]}-"


async def ensure(master: Master, environment: Mapping[str, str], logs: Path, guardian: Reaper | None) -> bool:
    """Have a master answer at ``master.uri``; whether it had to be started. Raises BackendError where none can be."""
    if await master.process() is not None:
        return False
    if not launching.is_local(master.uri):
        raise BackendError(f"no ROS master answers at {master.uri}, which is on another machine: start it there")
    port = str(rpc.address(master.uri)[1])
    log = logs / f"rosmaster-{port}.log"
    arguments = [launching.require_interpreter(), "-c", _PROGRAM, "--core", "-p", port, "-w", _WORKERS]
    process = spawn(arguments, Path("/"), {"ROS_LOG_DIR": str(logs), **environment, ENV_STARTED: port}, log)
    if guardian is not None:
        guardian.watch(process.pid, process.started)
    deadline = asyncio.get_running_loop().time() + _START
    try:
        while await master.process() is None:
            if not process.running:
                raise StartFailed(f"the ROS master did not start on port {port}:\n{tail(log).strip()}")
            if asyncio.get_running_loop().time() > deadline:
                raise StartFailed(f"the ROS master did not answer within {_START:g} s; its log: {log}")
            await asyncio.sleep(_POLL)
    except BaseException:  # cancelled, too, it leaves no master behind
        await process.end(StopTimes(0.0, _GRACE))
        if guardian is not None:
            guardian.release(process.pid)
        raise
    finally:
        process.close()
    return True


async def release(master: Master, guardian: Reaper | None) -> None:
    """End the master if Midstride started it and no other manager and no node needs it."""
    pid = await master.process()
    seen = None if pid is None else process_info(pid)
    if pid is None or seen is None:
        return
    process = find(pid, seen.started, ENV_STARTED, str(rpc.address(master.uri)[1]))
    if process is None:
        return
    if not await _in_use(master):
        await process.end(StopTimes(0.0, _GRACE))
        if guardian is not None:
            guardian.release(process.pid)
    process.close()


async def _in_use(master: Master) -> bool:
    """Return whether another manager needs the master, or a node is left that answers."""
    marks = f" @{_marks(master.uri)}"
    # Other programs' names may be any bytes.
    if any(marks in line for line in Path("/proc/net/unix").read_text(encoding="latin-1").split("\n")):
        return True
    left = sorted((await master.state()).nodes())
    return any(await asyncio.gather(*(master.is_running(node) for node in left)))
