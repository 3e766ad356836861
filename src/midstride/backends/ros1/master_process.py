"""The master's process: started where none runs, ended by whoever is the last to need it, if Midstride started it.

Under ``up`` the components outlive their manager, so the master they need does as well. The master that
Midstride started carries that in its environment: so any later manager knows it for what it is.
"""

from __future__ import annotations

import asyncio
import os
from pathlib import Path
from typing import Final

from midstride.backends.ros1 import launching, names, rpc
from midstride.backends.ros1.master import PROBE, Master
from midstride.errors import BackendError, StartFailed
from midstride.runtime.logs import tail
from midstride.runtime.process import find, spawn
from midstride.runtime.reaper import Reaper, process_info

ENV_STARTED: Final = "MIDSTRIDE_ROS1_MASTER"
# How long a master may take to answer after its start (s).
_START: Final = 10.0
_GRACE: Final = 2.0
_POLL: Final = 0.02
# The stock master tells subscribers of new publishers by three workers that look for work ten times a second: a new
# publisher is found after 50 to 100 ms, and three frozen subscribers keep everybody from being told. These do better.
_PROGRAM: Final = """
import sys
from rosmaster import rosmaster_main, threadpool
threadpool.ThreadPoolThread.threadSleepTime = 0.01
rosmaster_main(sys.argv)
"""
_WORKERS: Final = "16"


async def ensure(master: Master, logs: Path, guardian: Reaper | None) -> bool:
    """A master answers at ``master.uri``; whether it had to be started. Raises BackendError where none can be."""
    if await master.process() is not None:
        return False
    if not launching.is_local(master.uri):
        raise BackendError(f"no ROS master answers at {master.uri}, and it is not on this machine: start it there")
    port = str(rpc.address(master.uri)[1])
    environment = launching.environment(os.environ, master.uri)
    environment[ENV_STARTED] = port
    environment.setdefault("ROS_LOG_DIR", str(logs))
    log = logs / f"rosmaster-{port}.log"
    arguments = [launching.require_interpreter(), "-c", _PROGRAM, "--core", "-p", port, "-w", _WORKERS]
    process = spawn(arguments, Path("/"), environment, log)
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
    except BaseException:  # whoever is cancelled leaves no master behind either
        await process.end(_GRACE)
        if guardian is not None:
            guardian.release(process.pid)
        raise
    finally:
        process.close()
    return True


async def release(master: Master, guardian: Reaper | None) -> bool:
    """End the master if Midstride started it and no node is left; whether it has been ended."""
    number = await master.process()
    seen = None if number is None else process_info(number)
    if number is None or seen is None:
        return False
    process = find(number, seen.started, ENV_STARTED, str(rpc.address(master.uri)[1]))
    if process is None or await _in_use(master):
        if process is not None:
            process.close()
        return False
    await process.end(_GRACE)
    if guardian is not None:
        guardian.release(process.pid)
    process.close()
    return True


async def _in_use(master: Master) -> bool:
    """Whether some node is left that answers. Managers that were killed are forgotten on the way."""
    left = sorted((await master.state()).nodes() - {master.caller})
    return any(await asyncio.gather(*(master.holder(node) for node in left)))


async def forget_dead_managers(master: Master) -> None:
    """Take back what managers that were killed have left."""
    nodes = (await master.state()).nodes()
    await asyncio.gather(
        *(master.holder(node) for node in nodes if node.startswith(names.MANAGER) and node != master.caller)
    )


__all__ = ["ENV_STARTED", "PROBE", "ensure", "forget_dead_managers", "release"]
