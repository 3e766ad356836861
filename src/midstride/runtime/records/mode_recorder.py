"""In which mode each functionality was during a change, and because of what, as its component reported it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Final

from msgspec import Meta, structs

from midstride.codec.form import Report
from midstride.model.configuration import Configuration, Instance
from midstride.runtime.process.component_client import ComponentEvent
from midstride.wire.state import ComponentState, FunctionalityState

# By how much (s) the beginning of a mode may seem to move between two reports, which travel for different times.
SAME_MODE: Final = 0.5


class ModeInterval(Report, frozen=True, kw_only=True):
    """A functionality was in one mode; times in unix seconds. `because` says why it had entered it."""

    instance: str
    role: str
    functionality: str
    mode: str
    level: Annotated[int, Meta(description="of its mode: 0 is the best")]
    levels: Annotated[int, Meta(description="how many modes it has")]
    because: str | None
    reflex: Annotated[bool, Meta(description="the component's local reflex has led to this mode")]
    began: float
    ended: Annotated[float | None, Meta(description="null: it was in this mode to the end")]


def mode_level(modes: Sequence[str], mode: str) -> int:
    """The ``level`` of a mode: its place among ``modes``, the best first; that of an unknown one is the last."""
    return modes.index(mode) if mode in modes else max(len(modes) - 1, 0)


def in_order(intervals: Iterable[ModeInterval]) -> list[ModeInterval]:
    """By their beginning."""
    return sorted(intervals, key=lambda each: (each.began, each.instance, each.functionality))


@dataclass
class ModeRecorder:
    """Follows the reports of components from ``configuration`` on, and of ``created`` instances; ``now``: unix time.

    Every report counts: a mode that lasts for less than the time between two looks is recorded as well.
    """

    configuration: Configuration
    created: Iterable[Instance]
    now: Callable[[], float]
    _open: dict[tuple[str, str], ModeInterval] = field(default_factory=dict)
    _closed: list[ModeInterval] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._created = {instance.name: instance for instance in self.created}

    def on_component_event(self, event: ComponentEvent) -> None:
        if isinstance(event, ComponentState):
            self.reported(event, self.now())
        else:
            self._gone(event.instance, self.now())

    def reported(self, state: ComponentState, at: float) -> None:
        """A component has reported its state at ``at``."""
        instance = self.configuration.instances.get(state.instance) or self._created.get(state.instance)
        if instance is None:
            return
        for name, found in state.functionalities.items():
            key, began = (state.instance, name), at - found.since
            known = self._open.get(key)
            if known is not None:
                if known.mode == found.mode and abs(known.began - began) <= SAME_MODE:
                    continue
                began = max(began, known.began)
                self._closed.append(structs.replace(known, ended=began))
            self._open[key] = _interval(instance, name, found, began)

    def _gone(self, name: str, at: float) -> None:
        for key in [key for key in self._open if key[0] == name]:
            self._closed.append(structs.replace(self._open.pop(key), ended=at))

    def intervals(self, roles: Collection[str], since: float, remaining: Collection[str]) -> list[ModeInterval]:
        """The intervals from ``since`` on, of ``roles`` and of each functionality that was ever below its best mode.

        Instances that are not ``remaining`` have ended by now.
        """
        for name in {key[0] for key in self._open} - set(remaining):
            self._gone(name, self.now())
        found = [each for each in self._closed if each.ended is None or each.ended >= since]
        found += self._open.values()
        lowered = {(each.instance, each.functionality) for each in found if each.level}
        return in_order(each for each in found if each.role in roles or (each.instance, each.functionality) in lowered)


def _interval(instance: Instance, name: str, found: FunctionalityState, began: float) -> ModeInterval:
    functionality = instance.component.functionalities.get(name)
    modes = [] if functionality is None else [mode.name for mode in functionality.modes]
    return ModeInterval(
        instance=instance.name,
        role=instance.role,
        functionality=name,
        mode=found.mode,
        level=mode_level(modes, found.mode),
        levels=len(modes),
        because=found.because or None,
        reflex=found.reflex,
        began=round(began, 6),
        ended=None,
    )
