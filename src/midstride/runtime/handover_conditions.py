"""What must hold before the cut of a hand-over: else it would blind a subscriber, or never come."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final

from midstride.errors import CallTimeout, StepFailed, Unreachable
from midstride.model.action import Swap
from midstride.model.configuration import Configuration
from midstride.runtime.component_client import ComponentClient
from midstride.wire.commands import AwaitMatchCommand

# How long a subscriber may take to find the new publishers (s).
FIND_TIMEOUT: Final = 5.0


async def require_found(
    client: ComponentClient,
    configuration: Configuration,
    swaps: Iterable[Swap],
    connector: str,
    is_gone: Callable[[str], bool],
) -> None:
    """Raises StepFailed unless the subscribers of ``connector`` have found the new publishers.

    That the publishers have found them is not enough: a subscriber whose middleware does not discover endpoints any
    more would receive nothing after the cut.
    """
    attached = {*configuration.publishers_on(connector), *(swap.new for swap in swaps if swap.connector == connector)}
    living = sum(not is_gone(port.instance) for port in attached)
    topic = configuration.context.connectors[connector].topic
    for port in sorted(configuration.subscribers_on(connector)):
        await_match = AwaitMatchCommand(port=port.port, topic=topic, peers=living, timeout=FIND_TIMEOUT)
        try:
            matched = (await client.read(port.instance, await_match)).matched
        except (CallTimeout, Unreachable):
            continue  # a fault that is reported by itself
        if matched < living:
            raise StepFailed(
                f"{port} has found only {matched} of {living} publishers on {topic} within {FIND_TIMEOUT:g} s "
                "and would receive nothing after the hand-over; its middleware may have stopped discovering endpoints: "
                f"replace {port.instance} first"
            )


async def require_same_clock(client: ComponentClient, old: str, new: str) -> None:
    """Raises StepFailed unless both sides follow the same clock, and it has a time: they agree on a moment of it."""
    state = await client.peek(old)
    if state.simulated_time != (await client.peek(new)).simulated_time:
        simulated, other = (old, new) if state.simulated_time else (new, old)
        raise StepFailed(
            f"{simulated} follows /clock (use_sim_time) and {other} the clock of the system, so they cannot agree on a "
            "moment for the hand-over; set use_sim_time to the same value for both"
        )
    if state.waiting is not None:
        raise StepFailed(f"{old} cannot hand over: {state.waiting}")
