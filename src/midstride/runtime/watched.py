"""What the manager knows of the running system, for those that show it without asking its components."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from midstride.runtime.clock import Clock
from midstride.runtime.component_client import ComponentClient, ComponentEvent
from midstride.runtime.events import EventLog
from midstride.runtime.launcher import Launcher
from midstride.runtime.respawn import Respawner
from midstride.runtime.restoring import Restorer
from midstride.runtime.running_system import RunningSystem
from midstride.runtime.silence import SilenceMonitor


@dataclass
class WatchedSystem:
    """The parts of a manager that know something of the running system; to be read only.

    ``running`` is the command in progress. ``on_report`` is called after the manager has taken in what a component has
    reported, or that it has disconnected.
    """

    system: RunningSystem
    client: ComponentClient
    monitor: SilenceMonitor
    launcher: Launcher
    respawner: Respawner
    restorer: Restorer
    events: EventLog
    clock: Clock
    running: Callable[[], str | None]
    on_report: Callable[[ComponentEvent], object] = lambda _: None
