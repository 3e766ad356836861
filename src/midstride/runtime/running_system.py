"""The manager's knowledge of the running system, shared by its three parts."""

from __future__ import annotations

from dataclasses import dataclass

from midstride.model.configuration import Configuration
from midstride.model.specification import Specification


@dataclass(slots=True)
class RunningSystem:
    """``configuration`` is the model: it changes once components have acknowledged. ``revision`` counts its changes."""

    specification: Specification
    configuration: Configuration
    revision: int = 0

    def moved(self, configuration: Configuration) -> None:
        """A step or an event has changed the configuration."""
        self.configuration = configuration
        self.revision += 1
