"""Observers of a change: what they learn while it is carried out."""

from __future__ import annotations

from collections.abc import Collection

from midstride.model.action import Action, Handover
from midstride.model.configuration import Configuration


class ChangeObserver:
    """Follows one change. Each method is called when what it names has happened, and does nothing unless overridden."""

    __slots__ = ()

    def moved(self, configuration: Configuration, instances: Collection[str]) -> None:
        """A step has led to ``configuration`` and has changed ``instances``; or one of these has failed."""

    async def performed(self, action: Action) -> None:
        """An action of the plan, or of its roll-back, has been performed."""

    async def step_done(self, configuration: Configuration) -> None:
        """A step of the plan has led to ``configuration``. If this raises, the step has failed."""

    async def before_handover(self, configuration: Configuration, action: Handover) -> None:
        """A hand-over is about to begin in ``configuration``."""

    async def crashed(self) -> None:
        """A component has exited unexpectedly; the model still has it."""
