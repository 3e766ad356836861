"""A command that is interrupted says what becomes of its change: before the manager was asked, and afterwards."""

from __future__ import annotations

import json
from typing import Any

import pytest

from midstride.cli import follow
from midstride.cli.client import Client
from midstride.errors import ManagerError
from midstride.runtime.records.reports import Event
from tests.cli.conftest import Midstride

GOES_ON = "The manager continues with the change; `midstride log` shows how it ends."
NOTHING = "Nothing was changed: the manager had not been asked yet."
NOT_KNOWN = "Whether the manager carries out the change is not known: `midstride log` shows it."


def interrupt(*_: Any, **__: Any) -> Any:
    raise KeyboardInterrupt


@pytest.mark.parametrize("options", [[], ["--json"]])
def test_before_the_request_is_sent_nothing_is_changed(
    options: list[str], talker: Midstride, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = talker("log", "--json").json[-1]["n"]
    with monkeypatch.context() as patched:
        if options:
            patched.setattr(json, "dumps", interrupt)  # of the request
        else:
            patched.setattr(follow, "last_event_number", interrupt)
        done = talker("restart", "talker", "--yes", *options)
    assert (done.status, NOTHING in done.err, GOES_ON in done.err) == (130, True, False)
    assert talker("log", "--json").json[-1]["n"] == before


def test_a_request_that_is_withdrawn_is_not_sent_by_another_thread_later(talker: Midstride) -> None:
    before = talker("log", "--json").json[-1]["n"]
    sending = follow.Sending("1")
    assert sending.withdraw()
    client = Client(talker.runtime / "midstride" / "talker" / "manager.sock")
    with pytest.raises(follow.WithdrawnError):
        client.change({"request": {"restart": ["talker"]}, "id": "1"}, sending.begin)
    assert talker("log", "--json").json[-1]["n"] == before


class Manager(Client):
    """A manager that has these events."""

    def __init__(self, *ids: str | None) -> None:
        self._ids = ids
        self.asked = 0

    def log(self) -> list[Event]:
        self.asked += 1
        if None in self._ids:
            raise ManagerError("the manager exited")
        return [Event(n=n, at=0.0, kind="command", words="", id=id or "") for n, id in enumerate(self._ids, 1)]


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(follow, "BEGIN_TIMEOUT", 0.05)


@pytest.mark.usefixtures("impatient")
def test_once_it_has_begun_the_manager_is_asked_what_it_does() -> None:
    sending = follow.Sending("1")
    sending.begin()
    assert not sending.withdraw()
    assert sending.interrupted(Manager("0", "1")) == GOES_ON
    other = Manager("0")
    assert sending.interrupted(other) == NOT_KNOWN and other.asked > 1
    assert sending.interrupted(Manager(None)) == NOT_KNOWN
