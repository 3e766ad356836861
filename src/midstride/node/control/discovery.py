"""Checks that a component's own middleware still discovers endpoints. Control thread."""

from __future__ import annotations

from typing import Final

from midstride.node.component_host import Host
from midstride.wire import commands, replies

# How often the graph is looked at (s).
TICK: Final = 0.02


async def discover(host: Host, command: commands.DiscoverCommand) -> replies.Discovered:
    """Wait until the middleware shows a publisher on the topic."""
    deadline = host.steady() + int(command.timeout * 1e9)
    while (found := host.discovers(command.topic)) is False and host.steady() < deadline:
        await host.sleep(TICK)
    return replies.Discovered(found=found)
