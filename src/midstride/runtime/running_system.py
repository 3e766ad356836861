"""What the manager knows of the system that it runs: one value for its three parts to share."""

from __future__ import annotations

from dataclasses import dataclass

from midstride.model.configuration import Configuration
from midstride.model.specification import Specification


@dataclass(slots=True)
class RunningSystem:
    """``configuration`` is the model's: it moves on when components have acknowledged. ``revision`` counts that."""

    specification: Specification
    configuration: Configuration
    revision: int = 0

    def moved(self, configuration: Configuration) -> None:
        """A step, or an event, has led to ``configuration``."""
        self.configuration = configuration
        self.revision += 1
