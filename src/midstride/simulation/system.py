"""A simulated system: what is there from one seed to the next, while several of them change it one after the other."""

from __future__ import annotations

import contextlib
import gc
import logging
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any, Final

from midstride.errors import BackendError
from midstride.model.specification import Specification
from midstride.runtime.manager import Manager
from midstride.runtime.records.reports import Event
from midstride.runtime.records.state_store import SavedState, StateStore
from midstride.runtime.workspace import Workspace
from midstride.simulation.far_hosts import FarHost, SimulatedHosts, drawn_clocks
from midstride.simulation.invariants import Invariants
from midstride.simulation.killable_manager import Life
from midstride.simulation.loop import SeededLoop
from midstride.simulation.oracle import Oracle
from midstride.simulation.platform import Platform
from midstride.simulation.simulated_disk import SimulatedDisk
from midstride.simulation.stand_in import StandIn
from midstride.transitions import POLICY, reject

# Names the files of the simulated disk.
WORKSPACE: Final = Workspace(Path("simulated"))


class System:
    """A loop, a platform, a disk and the managers so far. ``specification`` is the one that was last in force.

    ``specifications``: every specification that it may have. ``on_event`` and ``on_exit`` are those of the seed that
    runs: called with each event of a manager, and with each process that has ended. The clocks of its hosts are drawn
    from ``seed``.
    """

    def __init__(self, specification: Specification, specifications: list[Specification], seed: int = 0) -> None:
        self.specification = specification
        gc.disable()  # finalizers would be called at moments that differ from run to run; and it takes time
        # What it does not implement, sockets and processes, the simulation does not have.
        self.loop = SeededLoop(0)  # type: ignore[abstract]
        self.platform = Platform(self._on_change)
        self.platform.time.follow(self.loop)
        self.invariants = Invariants(self.platform, Oracle(specifications))
        self.platform.network.on_publish = self.invariants.on_publish
        self.platform.on_import = self.invariants.on_import
        self.platform.network.services.observer = self.invariants.requests
        self.platform.network.services.outside = self.invariants.oracle.served_outside
        self.loop.observer = self.invariants
        self.disk = SimulatedDisk()
        # The hosts besides the manager's, and the latest manager's links to them.
        self.hosts: dict[str, FarHost] = {}
        self.backend: SimulatedHosts | None = None
        if specification.hosts:
            self.platform.clocks = drawn_clocks(specification.hosts, self.platform.time, seed)
        self._policy, POLICY.on_forbidden = POLICY.on_forbidden, self._reject
        self.lives: list[Life] = []
        self.manager: Manager | None = None
        self.on_event: Callable[[Life, Event], None] = lambda life, event: None
        self.on_exit: Callable[[StandIn], None] = lambda process: None

    def run(self, main: Coroutine[Any, Any, None]) -> None:
        """Run the coroutine; what else is under way goes on meanwhile. Raises BackendError, as the loop does."""
        logging.disable(logging.CRITICAL)
        try:
            self.loop.run_until_complete(main)
        finally:
            logging.disable(logging.NOTSET)

    def new_manager(self) -> Manager:
        """A new manager of the system as it is saved, or as it is specified."""
        backend = SimulatedHosts(self.platform, WORKSPACE, self.hosts)
        life = backend.life = Life(backend)
        self.backend = backend
        self.disk.life = life
        saved = self.saved() if self.lives else None
        declared = self.specification if saved is None else saved.specification
        self.manager = manager = Manager(declared, life.backend, WORKSPACE, WORKSPACE.path, disk=self.disk)
        self.lives.append(life)
        manager.events.listeners.append(lambda event: self.on_event(life, event))
        return manager

    def saved(self) -> SavedState | None:
        """The state that the next manager would find."""
        return StateStore(WORKSPACE.state, disk=self.disk).load()

    def recorded(self) -> list[str]:
        """The instances that the next manager would find."""
        database = self.disk.read_only(WORKSPACE.state)
        return [] if database is None else [name for (name,) in database.read("SELECT name FROM instances")]

    def lease(self) -> str | None:
        """The manager that has the lease."""
        database = self.disk.read_only(WORKSPACE.journal)
        rows = [] if database is None else database.read("SELECT value FROM about WHERE key = 'holder'")
        return rows[0][0] if rows else None

    def close(self) -> None:
        """End everything that is left of it."""
        self.on_event, self.on_exit = lambda life, event: None, lambda process: None
        self.invariants.violated = lambda words: None

        async def end() -> None:
            for life in self.lives:
                life.bury()
            await self.platform.shutdown()

        with contextlib.suppress(BackendError):  # a deadlock or a livelock, which has been reported
            try:
                self.run(end())
            finally:
                self.loop.end()
        gc.enable()
        POLICY.on_forbidden = self._policy

    def _reject(self, words: str) -> None:
        """A violation, even where what is raised is caught."""
        self.invariants.violated(words)
        reject(words)

    def _on_change(self, process: StandIn) -> None:
        self.invariants.on_change(process)
        if process.dead:
            self.on_exit(process)
