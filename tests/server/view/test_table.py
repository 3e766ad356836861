"""The table that all clients share: any patch leads from any state to the current one, and nothing grows."""

from __future__ import annotations

import json
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from midstride.server.view.table import GONE_LIMIT, PartKey, ViewTable, encode_view
from midstride.server.view.view_history import ViewRecording
from tests.server.view.support import Document, patched

_KEYS = st.sampled_from([("instances", name) for name in "abcd"] + [("topics", name) for name in "xy"])
_SINGLE = st.sampled_from([("phase", ""), ("change", "")])
_UPDATES = st.lists(
    st.dictionaries(_KEYS, st.one_of(st.none(), st.integers(0, 3))).flatmap(
        lambda keyed: st.dictionaries(_SINGLE, st.integers(0, 3)).map(lambda single: {**keyed, **single})
    ),
    min_size=1,
    max_size=25,
)


def entry(part: PartKey, value: int | None) -> bytes | None:
    if value is None:
        return None
    return json.dumps({"name": part[1], "value": value} if part[1] else value).encode()


def document(table: ViewTable) -> Document:
    found: Document = json.loads(encode_view(1, "m", table.n, table.at, table.parts()))
    return found


@given(_UPDATES)
def test_every_patch_leads_to_the_current_view(updates: list[dict[PartKey, Any]]) -> None:
    table = ViewTable()
    views: dict[int, Document] = {}
    for step, update in enumerate(updates):
        before = table.n
        changed = table.update({part: entry(part, value) for part, value in update.items()}, at=float(step))
        assert table.n == before + bool(changed)
        if table.n:
            views[table.n] = document(table)
        for n, view in views.items():
            assert table.knows(n)
            patch = json.loads(table.patch(n))
            assert patched(view, patch) == views[table.n]
            if n == table.n:
                assert patch.keys() == {"n", "at"}


@given(_UPDATES, st.integers(1, 12))
def test_earlier_views_are_as_they_were_and_the_recording_is_bounded(
    updates: list[dict[PartKey, Any]], limit: int
) -> None:
    table, recording = ViewTable(), ViewRecording(limit)
    views: dict[float, Document] = {}
    for step, update in enumerate(updates):
        changed = table.update({part: entry(part, value) for part, value in update.items()}, at=float(step))
        if changed:
            recording.record(table.n, float(step), changed)
        assert len(recording._records) <= limit
        if table.n:
            views[float(step)] = document(table)
    for at, view in views.items():
        past = recording.view_at(at + 0.5)
        if past is None:
            assert recording.oldest is not None and at + 0.5 < recording.oldest
        else:
            assert json.loads(encode_view(1, "m", past.n, past.at, past.parts)) == view
    last = recording.view_at(1e9)
    assert last is not None or not views


def test_what_has_gone_is_forgotten_in_time_and_its_clients_get_the_whole_view() -> None:
    table = ViewTable()
    table.update({("instances", "a"): b"1"}, at=0.0)
    for index in range(GONE_LIMIT + 1):
        name = f"gone_{index}"
        table.update({("instances", name): b"1"}, at=0.0)
        table.update({("instances", name): None}, at=0.0)
    assert not table.knows(1) and table.knows(table.n)
    assert len(table._entries) == 1
    table.update({("instances", "b"): b"2"}, at=0.0)
    assert json.loads(table.patch(table.n - 1))["instances"] == {"b": 2}


def test_a_state_that_does_not_exist_is_not_known() -> None:
    table = ViewTable()
    assert not table.knows(0)
    table.update({("phase", ""): b"1"}, at=0.0)
    assert not table.knows(0) and table.knows(1) and not table.knows(2)
