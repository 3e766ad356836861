"""The history of the view: its differences, and the modes of functionalities over time. In memory, and bounded.

The manager's journal keeps what lasts longer: changes, and incidents (GET /history).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

from msgspec import structs

from midstride.runtime.records.mode_recorder import ModeInterval, in_order, mode_level
from midstride.runtime.records.status_forms import FunctionalityStatus, InstanceStatus
from midstride.server.view.table import PartKey

# How many changed entries of views are kept, and how many modes that were left. An entry has 1 kB or so.
ENTRIES: Final = 20_000
INTERVALS: Final = 20_000


class _Record(NamedTuple):
    n: int
    at: float
    part: PartKey
    json: bytes | None


@dataclass(frozen=True, slots=True)
class PastView:
    """The view of a time: the number of its state, since when it was so, and its parts."""

    n: int
    at: float
    parts: Mapping[PartKey, bytes]


class ViewRecording:
    """The latest differences between views, and the view before the first of them."""

    def __init__(self, limit: int = ENTRIES) -> None:
        self._limit = limit
        self._first = PastView(0, 0.0, {})
        self._base: dict[PartKey, bytes] = {}
        self._records: deque[_Record] = deque()

    @property
    def oldest(self) -> float | None:
        """The earliest time of which the view is known (UNIX time); None before anything is."""
        if self._first.n:
            return self._first.at
        return self._records[0].at if self._records else None

    def record(self, n: int, at: float, changed: Mapping[PartKey, bytes | None]) -> None:
        """The view has become state ``n`` at this time, by these differences."""
        self._records.extend(_Record(n, at, part, json) for part, json in changed.items())
        while len(self._records) > self._limit:
            self._drop_oldest_state()

    def _drop_oldest_state(self) -> None:
        """States are dropped whole, so that no view is half of one and half of another."""
        n, at = self._records[0].n, self._records[0].at
        while self._records and self._records[0].n == n:
            _apply(self._base, self._records.popleft())
        self._first = PastView(n, at, self._base)

    def view_at(self, at: float) -> PastView | None:
        """The view as it was then; None for a time before the oldest that is known."""
        if self.oldest is None or at < self.oldest:
            return None
        n, since, parts = self._first.n, self._first.at, dict(self._base)
        for record in self._records:
            if record.at > at:
                break
            n, since = record.n, record.at
            _apply(parts, record)
        return PastView(n, since, parts)


def _apply(parts: dict[PartKey, bytes], record: _Record) -> None:
    if record.json is None:
        parts.pop(record.part, None)
    else:
        parts[record.part] = record.json


class ModeHistory:
    """The history of each functionality's modes, as the views of its component show it."""

    def __init__(self, limit: int = INTERVALS) -> None:
        self._open: dict[str, dict[str, ModeInterval]] = {}  # by instance and functionality
        self._closed: deque[ModeInterval] = deque(maxlen=limit)

    def shown(self, component: InstanceStatus, now: float) -> None:
        """An instance is like this at ``now`` (UNIX time). One that does not answer is as it was, as far as we know."""
        if not component.answers:
            return
        modes = self._open.setdefault(component.name, {})
        for functionality in component.functionalities:
            known = modes.get(functionality.name)
            if known is not None and (known.mode, known.began) == (functionality.mode, functionality.since):
                continue
            began = now if functionality.since is None else functionality.since
            if known is not None:
                self._closed.append(structs.replace(known, ended=began))
            modes[functionality.name] = _interval(component, functionality, began)

    def gone(self, instance: str, now: float) -> None:
        """An instance is not part of the system any more."""
        for interval in self._open.pop(instance, {}).values():
            self._closed.append(structs.replace(interval, ended=now))

    def between(self, since: float, until: float) -> list[ModeInterval]:
        """The intervals that overlap the time, by their beginning."""
        known = [*self._closed, *(interval for modes in self._open.values() for interval in modes.values())]
        begun = (interval for interval in known if interval.began <= until)
        return in_order(interval for interval in begun if interval.ended is None or interval.ended >= since)


def _interval(component: InstanceStatus, functionality: FunctionalityStatus, began: float) -> ModeInterval:
    return ModeInterval(
        instance=component.name,
        role=component.role,
        functionality=functionality.name,
        mode=functionality.mode,
        level=mode_level(functionality.modes, functionality.mode),
        levels=len(functionality.modes),
        because=functionality.because,
        reflex=functionality.reflex,
        began=began,
        ended=None,
    )
