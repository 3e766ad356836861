"""The instances that exited unexpectedly and have not been replaced."""

from __future__ import annotations

from collections.abc import Collection

from midstride.model.configuration import Configuration
from midstride.runtime.backend import Exited


class Crashes:
    """Unexpected exits by instance name.

    ``unreconciled`` instances are still in the model. ``missing`` ones have been removed from it, and no other instance
    has their role.
    """

    def __init__(self) -> None:
        self.unreconciled: dict[str, Exited] = {}
        self.missing: dict[str, Exited] = {}
        self._roles: dict[str, str] = {}  # of those that are missing

    def all(self) -> dict[str, Exited]:
        return {**self.missing, **self.unreconciled}

    def record(self, event: Exited) -> None:
        self.unreconciled[event.instance] = event

    def restarted(self, name: str) -> None:
        """An instance of that name has been started again."""
        self.unreconciled.pop(name, None)
        self.missing.pop(name, None)

    def take_unreconciled(self, configuration: Configuration) -> dict[str, Exited]:
        """The unreconciled exits of instances in ``configuration``, which the caller removes; they become missing."""
        crashed = {name: event for name, event in self.unreconciled.items() if name in configuration.instances}
        self.unreconciled = {}
        self.missing |= crashed
        self._roles |= {name: configuration.instances[name].role for name in crashed}
        return crashed

    def forget_filled(self, configuration: Configuration, roles: Collection[str]) -> None:
        """Forget missing instances whose role has an instance again, or is no longer one of ``roles``."""
        self.missing = {
            name: event
            for name, event in self.missing.items()
            if (role := self._roles[name]) in roles and not configuration.instances_by_role.get(role)
        }
