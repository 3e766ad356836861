"""Refuses to take over the system of an earlier manager where this one, of another version maybe, could not manage it.

All is asked while the earlier manager still runs: where one answer is no, nothing has ended.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from midstride.errors import CallTimeout, ManagerError, ProtocolError, Unreachable
from midstride.runtime.backend_protocol import Handle
from midstride.runtime.process.reaper import process_info
from midstride.runtime.records.state_store import SavedState
from midstride.wire.channel import Channel
from midstride.wire.transport import Transport

# How long a component may take to greet (s).
GREETING_TIMEOUT: Final = 5.0


def require_same_platform(saved: SavedState, system: str, backend: str, reach: Mapping[str, str]) -> None:
    """Raises ManagerError where this manager has another back end, or cannot reach what runs: in another domain, say.

    Each would report by its control socket, and what a manager starts or measures would be elsewhere.
    """
    if saved.backend != backend:
        raise ManagerError(f"{system} runs on {saved.backend}; use that back end, or `midstride down` first")
    other = {name: value for name, value in saved.reach.items() if reach.get(name, value) != value}
    running = [entry.instance.name for entry in saved.instances if entry.handle and runs(entry.handle)]
    if not (other and running):
        return
    theirs = ", ".join(f"{name}={value}" for name, value in other.items())
    this = ", ".join(f"{name}={reach[name]}" for name in other)
    them, goes = ("it", "runs") if len(running) == 1 else ("them", "run")
    raise ManagerError(
        f"{', '.join(running)} {goes} with {theirs}, and this manager has {this}, so it would not reach {them}: "
        f"run `midstride up` with {theirs} again, or `midstride down` first"
    )


async def require_spoken(saved: SavedState, transport: Transport) -> None:
    """Raises ManagerError where a component that an earlier manager started does not answer, or not in a version of the
    control protocol that is spoken here.

    For a node without Midstride's API, the manager itself answers.
    """
    faults = []
    for entry in saved.instances:
        if entry.handle is None or entry.done or not runs(entry.handle):
            continue
        name = entry.instance.name
        try:
            channel = await Channel.open(transport, transport.address(name), saved.token, timeout=GREETING_TIMEOUT)
        except ProtocolError as error:
            faults.append(str(error))
        except (CallTimeout, Unreachable):
            faults.append(f"{name} runs (process {entry.handle.pid}), but does not answer on its control socket")
        else:
            channel.close()
    if faults:
        raise ManagerError("; ".join(faults))


def runs(handle: Handle) -> bool:
    """Return whether the process of ``handle`` runs; False where it is not known."""
    info = None if handle.pid is None or handle.host else process_info(handle.pid)
    return info is not None and info.alive and info.started == handle.started
