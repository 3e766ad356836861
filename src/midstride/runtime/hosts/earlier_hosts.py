"""Looks at the hosts of an earlier manager, which still runs, before another one takes over."""

from __future__ import annotations

import asyncio
import tempfile
from pathlib import Path
from typing import Final

from midstride.errors import CallTimeout, ProtocolError, Unreachable
from midstride.model.hosts import HostSpec
from midstride.runtime.backend_protocol import Backend
from midstride.runtime.hosts.host_link import HostLink
from midstride.runtime.hosts.hosts_backend import order_for
from midstride.runtime.records.state_store import SavedState
from midstride.wire.channel import Channel
from midstride.wire.sockets import ForwardedConnection, SocketFolder

# How long a component may take to greet (s).
GREETING_TIMEOUT: Final = 5.0


async def faults_on_hosts(saved: SavedState, own: Backend) -> list[str]:
    """The reasons why a manager with the back end ``own`` could not take over what is ``saved`` of other hosts.

    The links only read, so the earlier manager keeps its own.
    """
    handles = (entry.handle for entry in saved.instances if entry.handle is not None and not entry.done)
    used, declared = sorted({handle.host for handle in handles} - {""}), saved.specification.hosts
    unknown = [f"host {name}, where nodes may run, is not declared any more" for name in used if name not in declared]
    if unknown:
        return unknown
    with tempfile.TemporaryDirectory(prefix="midstride-") as folder:
        found = (_faults_on(declared[name], saved, own, Path(folder)) for name in used)
        return [fault for faults in await asyncio.gather(*found) for fault in faults]


async def _faults_on(host: HostSpec, saved: SavedState, own: Backend, folder: Path) -> list[str]:
    order = order_for(saved.specification.name, host, own, middleware_settings=saved.options.middleware_settings)
    link = HostLink(host, order, folder, str, lambda _: None, reads=True)
    faults: list[str] = []
    try:
        await link.open()
        if link.problem is not None:
            return [f"host {host.name} cannot be reached: {link.problem}"]
        for entry in saved.instances:
            if entry.handle is None or entry.done or entry.handle.host != host.name:
                continue
            name = entry.instance.name
            try:
                channel = await Channel.open(_Through(link, name, folder), name, saved.token, timeout=GREETING_TIMEOUT)
            except ProtocolError as error:
                faults.append(f"{error} (on host {host.name})")
            except CallTimeout:
                faults.append(f"{name} does not answer on its control socket (on host {host.name})")
            except Unreachable:
                pass  # it has exited
            else:
                channel.close()
    finally:
        await link.close()
    return faults


class _Through(SocketFolder):
    """The way to one component through a link."""

    def __init__(self, link: HostLink, instance: str, folder: Path) -> None:
        super().__init__(folder)
        self._link, self._instance = link, instance

    async def connect(self, address: str) -> ForwardedConnection:
        return await self._link.connect(self._instance)
