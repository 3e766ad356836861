"""The status of a system that has just come up, once the rates that its outputs guarantee are judged."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from midstride.wire.state import RATE_TOLERANCE

if TYPE_CHECKING:
    from midstride.cli.client import Client
    from midstride.runtime.records.status_forms import PortStatus, Status

# How long `up` waits for rates to be judged (s): a window is 1 s for 10 Hz or more, and reports come twice a second.
PATIENCE: Final = 2.5
_POLL: Final = 0.1


def await_rates(client: Client) -> tuple[Status, list[str]]:
    """The status once each output keeps its rate so far, or has been measured over a whole window; or after PATIENCE.

    Besides, the outputs of which it is not known by then.
    """
    end = time.monotonic() + PATIENCE
    while True:
        status = client.status()
        pending = list(_pending(status))
        if not pending or time.monotonic() >= end:
            return status, pending
        time.sleep(_POLL)


def _pending(status: Status) -> Iterator[str]:
    for instance in status.instances:
        for port in instance.ports:
            if port.direction == "out" and port.gate == "open" and port.declared and not _judged(port, port.declared):
                yield f"{instance.name}.{port.name}"


def _judged(port: PortStatus, declared: float) -> bool:
    return port.met is not None or (port.rate or 0.0) >= (1 - RATE_TOLERANCE) * declared
