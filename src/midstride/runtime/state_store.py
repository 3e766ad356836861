"""What the next manager needs to find this system again, written down as things happen.

A manager may be killed at any moment. What it has started by then must be in the state, components that are still on
their way included: a process that nobody knows of would run for ever, under a name that is then taken.
"""

from __future__ import annotations

from collections.abc import Callable

from midstride.errors import ManagerError
from midstride.model.configuration import Configuration, Instance
from midstride.model.specification import Specification
from midstride.runtime.launcher import Launcher
from midstride.runtime.recovery import state_document
from midstride.runtime.workspace import Workspace


class StateStore:
    """Keeps the state of one system. ``tell`` is told where the disk refuses, once; ``unwritten`` says so as long."""

    def __init__(
        self, workspace: Workspace, backend: str, token: str, launcher: Launcher, tell: Callable[[str], object]
    ) -> None:
        self.unwritten: str | None = None
        self._workspace = workspace
        self._backend = backend
        self._token = token
        self._launcher = launcher
        self._tell = tell
        self._started: dict[str, Instance] = {}

    def started(self, instance: Instance) -> None:
        """The process of ``instance`` has been started. It is kept until it is in the configuration, or has ended."""
        self._started[instance.name] = instance

    def save(self, specification: Specification, configuration: Configuration) -> None:
        """Keep the state. A disk that refuses does not stop a change half way: it is told."""
        try:
            self.require(specification, configuration)
        except ManagerError as error:
            if self.unwritten is None:
                self._tell(f"{error}; a later manager would not find everything again")
            self.unwritten = str(error)

    def require(self, specification: Specification, configuration: Configuration) -> None:
        """Keep the state. Raises ManagerError where the disk refuses."""
        handles = self._launcher.handles
        self._started = {
            name: instance
            for name, instance in self._started.items()
            if name in handles and name not in configuration.instances
        }
        instances = [*configuration.instances.values(), *self._started.values()]
        attachments = list(configuration.attachments())
        self._workspace.save(state_document(specification, self._backend, self._token, instances, attachments, handles))
        self.unwritten = None

    def forget(self, *, unless_running: bool = False) -> None:
        """The system is down, or never came up. With ``unless_running`` the state stays while a component does."""
        if not (unless_running and self._launcher.handles):
            self._workspace.forget()
