"""The manager's knowledge of the running system, shared by its three parts."""

from __future__ import annotations

from dataclasses import dataclass, field

from midstride.errors import ManagerError
from midstride.model.configuration import Configuration, Instance
from midstride.model.specification import Specification
from midstride.plan.request import require
from midstride.runtime.backend_protocol import Exited
from midstride.runtime.watch.reported_values import ReportedValues


@dataclass(slots=True)
class RunningSystem:
    """``configuration`` is the model: it changes once components have acknowledged. ``revision`` counts its changes.

    Instances that exited unexpectedly are in ``crashed`` until they are removed from the model, and then in ``missing``
    until another instance has their role. ``values``: the parameter values that were set at run time.
    ``file`` was brought up or applied last, and ``changed_since``: another command has changed the specification then.
    """

    specification: Specification
    configuration: Configuration
    file: str | None = None
    changed_since: bool = False
    revision: int = 0
    crashed: dict[str, Exited] = field(default_factory=dict)
    missing: dict[str, Exited] = field(default_factory=dict)
    values: ReportedValues = field(default_factory=ReportedValues)
    _missing_roles: dict[str, str] = field(default_factory=dict)

    def has_instance(self, role: str) -> bool:
        """Whether an instance has that role: it answers requests until its successor is to."""
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

    def started(self, name: str) -> None:
        """An instance of that name has been started (again)."""
        self.crashed.pop(name, None)
        self.missing.pop(name, None)

    def take_crashed(self) -> list[str]:
        """The crashed instances that are in the model, by name; the caller removes them, so they become missing."""
        found = [name for name in self.crashed if name in self.configuration.instances]
        self.missing |= {name: self.crashed[name] for name in found}
        self._missing_roles |= {name: self.configuration.instances[name].role for name in found}
        self.crashed.clear()
        return sorted(found)

    def lost(self, instance: Instance) -> None:
        """An instance that an earlier manager knew has exited."""
        self.missing[instance.name] = Exited(instance.name, None)
        self._missing_roles[instance.name] = instance.role

    def role_of_missing(self, name: str) -> str | None:
        """The role of an instance that exited unexpectedly, if it is in the specification."""
        role = self._missing_roles.get(name)
        return role if role in self.specification.nodes else None

    def remedy(self, role: str) -> str:
        """What to do about a role whose instance has exited, or no longer does what it should."""
        by_hand = self.specification.component_of(role).run is None
        return f"{'start it, then ' if by_hand else ''}`midstride restart {role}` restores it"

    def why_missing(self, role: str) -> str | None:
        """Why a role has no instance, if one has exited unexpectedly."""
        names = [name for name in self.missing if self._missing_roles[name] == role]
        return f"{names[-1]} exited unexpectedly" if names else None

    def forget_filled_roles(self) -> None:
        """Forget missing instances whose role has an instance again, or has been removed from the specification."""
        self.missing = {
            name: event
            for name, event in self.missing.items()
            if (role := self._missing_roles[name]) in self.specification.nodes
            and not self.configuration.instances_by_role.get(role)
        }
