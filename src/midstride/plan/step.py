"""One step of a plan: an action of the model, with its duration and its mode changes by name."""

from __future__ import annotations

from dataclasses import dataclass

from midstride.model import wording
from midstride.model.action import Action, Degrade, Upgrade
from midstride.model.component import FunctionalityRef
from midstride.model.configuration import Configuration


@dataclass(frozen=True, slots=True)
class ModeChange:
    """A functionality of an instance, the mode it leaves and the mode it enters, by name."""

    functionality: FunctionalityRef
    before: str
    after: str


@dataclass(frozen=True, slots=True)
class Step:
    """An action, its estimated duration (s), the roles it belongs to, and its mode changes by name.

    ``between``: the shortest and the longest duration, as measured or stated; None where they do not differ.
    """

    action: Action
    seconds: float
    roles: tuple[str, ...]
    modes: tuple[ModeChange, ...] = ()
    between: tuple[float, float] | None = None

    @property
    def is_structural(self) -> bool:
        """Return whether the step changes what is live or attached."""
        return self.action.is_structural

    def describe(self) -> str:
        """The step in words, modes by name."""
        if isinstance(self.action, (Degrade, Upgrade)):
            changes = ((str(change.functionality), change.before, change.after) for change in self.modes)
            return wording.mode_changes(self.action.kind, changes)
        return self.action.describe()

    def __str__(self) -> str:
        return self.describe()


def mode_changes(configuration: Configuration, action: Action) -> tuple[ModeChange, ...]:
    """The mode changes of an action about to be carried out in ``configuration``, sorted."""
    if not isinstance(action, (Degrade, Upgrade)):
        return ()
    return tuple(
        ModeChange(ref, configuration.mode(ref).name, configuration.functionality(ref).modes[index].name)
        for ref, index in sorted(action.modes.items())
    )
