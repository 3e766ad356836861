"""The manager's knowledge of the running system, for views that are made without asking its components."""

from __future__ import annotations

from dataclasses import dataclass, field

from midstride.model.component import FunctionalityRef
from midstride.model.configuration import Configuration
from midstride.model.specification import Specification, initial
from midstride.runtime.change.change_session import ChangeSession
from midstride.runtime.restore.fallback_leases import FallbackLeases
from midstride.runtime.restore.respawner import Respawner
from midstride.runtime.restore.restoring import Restorer


class Baseline:
    """The system that the specification describes: for each role its component, its attachments, and the best modes
    that the system allows.
    """

    def __init__(self, specification: Specification, intended: Configuration) -> None:
        self.specification = specification
        self._intended = intended

    def level(self, role: str, functionality: str) -> int:
        """The level of the mode that a functionality of a role should be in; 0 (the best) for an unknown one."""
        return self._intended.modes.get(FunctionalityRef(role, functionality), 0)

    def attached(self, role: str) -> list[tuple[str, str]]:
        """The ports of a role that should be attached, each with its connector."""
        if role not in self._intended.instances:
            return []
        return [(port.port, connector) for port, connector in self._intended.attached_ports(role)]


@dataclass
class WatchedSystem:
    """The parts of a manager that know something of the running system, those of ``session`` included; to be read only.

    ``spares``: how many processes are to be kept ready.
    """

    session: ChangeSession
    respawner: Respawner
    restorer: Restorer
    leases: FallbackLeases
    spares: int
    _baseline: Baseline | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        shared = self.session
        self.system, self.client, self.launcher = shared.system, shared.client, shared.launcher
        self.events, self.store, self.commands = shared.events, shared.store, shared.commands
        self.monitor, self.clock = shared.monitor, shared.clock
        self.backend, self.journal = shared.backend, shared.journal
        self.permission = shared.permission

    def baseline(self) -> Baseline:
        """The baseline of the specification that the system runs."""
        specification = self.system.specification
        if self._baseline is None or self._baseline.specification is not specification:
            self._baseline = Baseline(specification, initial(specification))
        return self._baseline
