"""The manager's knowledge of the running system, shared by its three parts."""

from __future__ import annotations

from dataclasses import dataclass, field

from midstride.errors import ManagerError
from midstride.model.configuration import Configuration, Instance
from midstride.model.specification import Specification
from midstride.plan.request import require
from midstride.runtime.backend_protocol import Exited, OtherNodes
from midstride.runtime.instance_life import LifeTable, ProcessEvent
from midstride.runtime.records.counts import EventCounts
from midstride.runtime.records.state_store import LeftState
from midstride.runtime.watch.reported_values import ReportedValues


@dataclass(slots=True)
class RunningSystem:
    """``configuration`` is the model: it changes once components have acknowledged. ``revision`` counts its changes.

    ``life`` knows what became of each instance. ``values``: the parameter values that were set at run time.
    ``other_nodes``: by instance, the nodes that its end would end as well, as they were when last asked for.
    ``exported``: by role, the state of an instance that a change has removed before its successor was there.
    ``apart``: by role without an instance, the container that its last one had left for a process for itself, or that
    has exited or hung while it loaded that: the next one starts in a process for itself.
    ``counts``: how often nodes have crashed, and how changes have ended, since the manager started.
    ``file`` was brought up or applied last, and ``changed_since``: another command has changed the specification then.
    """

    specification: Specification
    configuration: Configuration
    life: LifeTable
    file: str | None = None
    changed_since: bool = False
    revision: int = 0
    values: ReportedValues = field(default_factory=ReportedValues)
    other_nodes: dict[str, OtherNodes] = field(default_factory=dict)
    exported: dict[str, LeftState] = field(default_factory=dict)
    apart: dict[str, str] = field(default_factory=dict)
    counts: EventCounts = field(default_factory=EventCounts)

    def has_instance(self, role: str) -> bool:
        """Return whether an instance has that role: it answers requests until its successor is to."""
        return bool(self.configuration.instances_by_role.get(role))

    def live_instance(self, node: str) -> str:
        """The instance of that name, else the one of that role. Raises PlanRefused, or ManagerError if none runs."""
        if node in self.configuration.instances:
            return node
        require("node", node, self.specification.nodes)
        for instance in self.configuration.instances_of(node):
            return instance.name
        raise ManagerError(f"{node} is not running; {self.remedy(node)}")

    def moved(self, configuration: Configuration) -> None:
        """A step or an event has changed the configuration."""
        self.configuration = configuration
        self.revision += 1

    def role_of_missing(self, name: str) -> str | None:
        """The role of an instance that exited unexpectedly, if it is in the specification."""
        role = self.life[name].role
        return role if role in self.specification.nodes else None

    def remedy(self, role: str) -> str:
        """The remedy for a role whose instance has exited, or no longer does what it should."""
        by_hand = self.specification.component_of(role).run is None
        return f"{'start it, then ' if by_hand else ''}`midstride restart {role}` restores it"

    @property
    def crashes(self) -> dict[str, list[Exited]]:
        """The exits of the missing instances of each role of the specification, the earliest first."""
        found: dict[str, list[Exited]] = {}
        for name, exited in self.life.missing.items():
            if (role := self.role_of_missing(name)) is not None:
                found.setdefault(role, []).append(exited)
        return found

    def why_missing(self, role: str) -> str | None:
        """The reason why a role has no instance, if one has exited unexpectedly, or could not be started."""
        crashes = self.crashes.get(role)
        return crashes[-1].details if crashes else None

    def gone(self, instance: Instance) -> None:
        """An instance of the model has exited unexpectedly: the next one of its role starts where it was."""
        self.apart.pop(instance.role, None)
        if instance.container is not None and not instance.process:
            self.apart[instance.role] = instance.container.name

    def _is_apart(self, role: str, container: str) -> bool:
        node = self.specification.nodes.get(role)
        return node is not None and node.container == container and not self.has_instance(role)

    def forget_filled_roles(self) -> None:
        """Forget missing instances whose role has an instance again, or has been removed from the specification."""
        self.apart = {role: name for role, name in self.apart.items() if self._is_apart(role, name)}
        for name in self.life.missing:
            if (role := self.role_of_missing(name)) is None or self.has_instance(role):
                silent = self.life[name].silent
                self.life.record(name, ProcessEvent.SUPPLANTED if silent else ProcessEvent.REPLACED)
