"""The status of a running system at the first fault within a time: for `status --for`, after a change."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Final

from midstride.cli.client import Client
from midstride.cli.follow import last_event_number
from midstride.errors import MidstrideError

if TYPE_CHECKING:
    from midstride.runtime.records.status_forms import Status

# How often the status is looked at where no event has come (s): rates fall without one.
LOOK: Final = 1.0


def status_at_first_fault(client: Client, seconds: float) -> Status:
    """Return the status when the system is not up for the first time, else that after ``seconds``.

    It is looked at after each event, since a node may degrade and be restored in less than a second, and at least
    every :data:`LOOK`. Raises ManagerError where the manager ends meanwhile.
    """
    end = time.monotonic() + seconds
    happened = _set_by_events(client)
    while True:
        happened.clear()
        status = client.status()
        left = end - time.monotonic()
        if left <= 0 or status.condition.state != "up":
            return status
        happened.wait(min(LOOK, left))


def _set_by_events(client: Client) -> threading.Event:
    """A flag that each event of the manager from now on sets."""
    happened = threading.Event()
    since = last_event_number(client)

    def read() -> None:
        try:
            for _ in client.events(since):
                happened.set()
        except MidstrideError:  # the next look at the status reports it
            return

    threading.Thread(target=read, daemon=True).start()
    return happened
