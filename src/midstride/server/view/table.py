"""The current view as encoded parts, each with the number of the state in which it last changed.

Every client shares it. What a client lacks is what has changed after the state that it was last sent, so nothing is
kept for each of them but that number.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final, TypeAlias

import msgspec

# The keyed lists of a view; any other part is one value, under the key "".
KEYED: Final = ("instances", "topics")
PartKey: TypeAlias = tuple[str, str]  # the field of the view, and the key in it
# For how many entries that are gone it is remembered when: a client that lacks more is sent the whole view.
GONE_LIMIT: Final = 1_000


@dataclass(frozen=True, slots=True)
class Entry:
    """A part as JSON, None once it is gone, and the number of the state since which it is so."""

    n: int
    json: bytes | None


class ViewTable:
    """``n`` is the number of the current state, ``at`` since when it is current (UNIX time)."""

    def __init__(self) -> None:
        self.n = 0
        self.at = 0.0
        # In the order of their changes, so that the latest can be found without looking at the others.
        self._entries: dict[PartKey, Entry] = {}
        self._gone = 0
        self._oldest = 0  # what was gone by then is not remembered
        self._patches: dict[int, bytes] = {}  # to the current state, by the number of the earlier one

    def update(self, changes: Mapping[PartKey, bytes | None], at: float) -> dict[PartKey, bytes | None]:
        """Take in ``changes``; None for what is gone. Returns what of it differs: the new state, if anything does."""
        changed = {part: json for part, json in changes.items() if self.json(part) != json}
        if not changed:
            return changed
        self.n, self.at = self.n + 1, at
        self._patches.clear()
        for part, json in changed.items():
            before = self._entries.pop(part, None)
            self._gone += (json is None) - (before is not None and before.json is None)
            self._entries[part] = Entry(self.n, json)
        if self._gone > GONE_LIMIT:
            self._forget_gone()
        return changed

    def _forget_gone(self) -> None:
        self._entries = {part: entry for part, entry in self._entries.items() if entry.json is not None}
        self._gone, self._oldest = 0, self.n

    def json(self, part: PartKey) -> bytes | None:
        """The part as it is; None where there is none."""
        entry = self._entries.get(part)
        return None if entry is None else entry.json

    def parts(self) -> dict[PartKey, bytes]:
        """All that there is."""
        return {part: entry.json for part, entry in self._entries.items() if entry.json is not None}

    def knows(self, n: int) -> bool:
        """Return whether a patch from state ``n`` to the current one can be made."""
        return self._oldest <= n <= self.n and n > 0

    def patch(self, n: int) -> bytes:
        """The patch from state ``n``, which it :meth:`knows`, to the current one. Clients at one state share it."""
        if n not in self._patches:
            self._patches[n] = encode_patch(self.n, self.at, self._changed_after(n))
        return self._patches[n]

    def _changed_after(self, n: int) -> dict[PartKey, bytes | None]:
        found: dict[PartKey, bytes | None] = {}
        for part in reversed(self._entries):
            entry = self._entries[part]
            if entry.n <= n:
                break
            found[part] = entry.json
        return found


def encode_view(version: int, manager: str, n: int, at: float, parts: Mapping[PartKey, bytes]) -> bytes:
    """The whole view as JSON. ``parts`` has all of its other fields."""
    fields: list[tuple[str, bytes]] = [("version", b"%d" % version), ("manager", msgspec.json.encode(manager))]
    fields += _head(n, at)
    fields += [(field, json) for (field, _), json in sorted(parts.items()) if field not in KEYED]
    for keyed in KEYED:
        entries = (json for (field, _), json in sorted(parts.items()) if field == keyed)
        fields.append((keyed, b"[%s]" % b",".join(entries)))
    return _object(fields)


def encode_patch(n: int, at: float, changed: Mapping[PartKey, bytes | None]) -> bytes:
    """The patch that leads to state ``n`` as JSON."""
    fields = _head(n, at)
    fields += [(field, json or b"null") for (field, _), json in sorted(changed.items()) if field not in KEYED]
    for keyed in KEYED:
        entries = [(key, json or b"null") for (field, key), json in sorted(changed.items()) if field == keyed]
        if entries:
            fields.append((keyed, _object(entries)))
    return _object(fields)


def _head(n: int, at: float) -> list[tuple[str, bytes]]:
    return [("n", b"%d" % n), ("at", msgspec.json.encode(round(at, 3)))]


def _object(fields: Iterable[tuple[str, bytes]]) -> bytes:
    return b"{%s}" % b",".join(b"%s:%s" % (msgspec.json.encode(name), json) for name, json in fields)
