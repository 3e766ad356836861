"""Who has ended by itself: still in the model, or out of it and not come back."""

from __future__ import annotations

from collections.abc import Collection

from midstride.model.configuration import Configuration
from midstride.runtime.backend import Exited


class Crashes:
    """What is known of components that have ended by themselves, by their names.

    ``unsettled`` are still in the model; ``missing`` are not, and nobody plays their roles since.
    """

    def __init__(self) -> None:
        self.unsettled: dict[str, Exited] = {}
        self.missing: dict[str, Exited] = {}
        self._roles: dict[str, str] = {}  # of those that are missing

    def all(self) -> dict[str, Exited]:
        return {**self.missing, **self.unsettled}

    def ended(self, event: Exited) -> None:
        self.unsettled[event.instance] = event

    def returned(self, name: str) -> None:
        """An instance of that name is started again."""
        self.unsettled.pop(name, None)
        self.missing.pop(name, None)

    def settle(self, configuration: Configuration) -> dict[str, Exited]:
        """Those of the model ``configuration`` that are to be taken out of it; they are missing from now on."""
        gone = {name: event for name, event in self.unsettled.items() if name in configuration.instances}
        self.unsettled = {}
        self.missing |= gone
        self._roles |= {name: configuration.instances[name].role for name in gone}
        return gone

    def forget(self, configuration: Configuration, roles: Collection[str]) -> None:
        """Whose role is played again, by whatever instance, or is none of ``roles`` any more, is not missing."""
        self.missing = {
            name: event
            for name, event in self.missing.items()
            if (role := self._roles[name]) in roles and not configuration.instances_by_role.get(role)
        }
