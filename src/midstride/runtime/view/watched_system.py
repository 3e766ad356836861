"""What the manager knows of the running system, for those that show it without asking its components."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from midstride.runtime.command_queue import CommandQueue
from midstride.runtime.manager_clock import Clock
from midstride.runtime.process.component_client import ComponentClient, ComponentEvent
from midstride.runtime.process.launcher import Launcher
from midstride.runtime.records.events import EventLog
from midstride.runtime.restore.respawner import Respawner
from midstride.runtime.restore.restoring import Restorer
from midstride.runtime.running_system import RunningSystem
from midstride.runtime.watch.silence import SilenceMonitor


@dataclass
class WatchedSystem:
    """The parts of a manager that know something of the running system; to be read only.

    ``on_report`` is called after the manager has taken in what a component has reported, or that it has disconnected.
    """

    system: RunningSystem
    client: ComponentClient
    monitor: SilenceMonitor
    launcher: Launcher
    respawner: Respawner
    restorer: Restorer
    events: EventLog
    clock: Clock
    commands: CommandQueue
    on_report: Callable[[ComponentEvent], object] = lambda _: None

    def on_component_event(self, event: ComponentEvent) -> None:
        """The manager has taken in ``event``."""
        self.on_report(event)
