"""What the manager knows of the running system, for those that show it without asking its components."""

from __future__ import annotations

from dataclasses import dataclass, field

from midstride.model.component import FunctionalityRef
from midstride.model.configuration import Configuration
from midstride.model.specification import Specification, initial
from midstride.runtime.backend_protocol import Backend
from midstride.runtime.command_queue import CommandQueue
from midstride.runtime.manager_clock import Clock
from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.process.launcher import Launcher
from midstride.runtime.records.events import EventLog
from midstride.runtime.records.journal import Journal
from midstride.runtime.records.state_store import StateStore
from midstride.runtime.restore.respawner import Respawner
from midstride.runtime.restore.restoring import Restorer
from midstride.runtime.running_system import RunningSystem
from midstride.runtime.watch.silence import SilenceMonitor


class Baseline:
    """What the specification provides: for each role its component, and the best modes that the system allows."""

    def __init__(self, specification: Specification, intended: Configuration) -> None:
        self.specification = specification
        self._modes = intended.modes

    def level(self, role: str, functionality: str) -> int:
        """The level of the mode that a functionality of a role should be in; 0 (the best) for an unknown one."""
        return self._modes.get(FunctionalityRef(role, functionality), 0)


@dataclass
class WatchedSystem:
    """The parts of a manager that know something of the running system; to be read only.

    ``spares``: how many processes are to be kept ready.
    """

    system: RunningSystem
    client: ComponentClient
    monitor: SilenceMonitor
    launcher: Launcher
    respawner: Respawner
    restorer: Restorer
    events: EventLog
    commands: CommandQueue
    backend: Backend
    store: StateStore
    journal: Journal
    spares: int
    _baseline: Baseline | None = field(default=None, init=False)

    @property
    def clock(self) -> Clock:
        return self.backend.clock

    def baseline(self) -> Baseline:
        """The baseline of the specification that the system runs."""
        specification = self.system.specification
        if self._baseline is None or self._baseline.specification is not specification:
            self._baseline = Baseline(specification, initial(specification))
        return self._baseline
