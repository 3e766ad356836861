"""A command that is interrupted says what becomes of its work: before the manager was asked, and afterwards."""

from __future__ import annotations

import contextlib
import json
import shutil
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import click
import pytest

from midstride.cli import client, follow, shutdown
from midstride.cli.client import Client
from midstride.cli.commands import dev, up
from midstride.cli.dev.requested_changes import Changes
from midstride.errors import ManagerError
from midstride.runtime.records.reports import Event, Outcome, UpReport
from tests.cli.conftest import EXAMPLES, Done, Midstride

GOES_ON = "The manager continues with the change; `midstride log` shows how it ends."
NOTHING = "Nothing was changed: the manager had not been asked yet."
NOT_KNOWN = "Whether the manager carries out the change is not known: `midstride log` shows it."
HAD_ENDED = "The change had ended; `midstride log` shows how."
LATER = "The manager carries out the change later: `b` waits for `a`. `midstride log` shows how it ends."


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
    """A manager that has these events, of the kind, with the id and the words; None: that has exited."""

    def __init__(self, *events: tuple[str, str, str] | None) -> None:
        self._events = events
        self.asked = 0

    def log(self) -> list[Event]:
        self.asked += 1
        if None in self._events:
            raise ManagerError("the manager exited")
        found = [event for event in self._events if event is not None]
        return [Event(n=n, at=0.0, kind=kind, words=words, id=id) for n, (kind, id, words) in enumerate(found, 1)]


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(follow, "BEGIN_TIMEOUT", 0.05)


OTHER, WAITING, BEGUN = ("command", "0", "a"), ("waiting", "1", "`b` waits for `a`"), ("command", "1", "b")


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize(
    ("events", "words"),
    [
        ([OTHER], NOT_KNOWN),
        ([None], NOT_KNOWN),
        ([OTHER, WAITING], LATER),
        ([OTHER, WAITING, ("outcome", "", "done")], LATER),
        ([OTHER, WAITING, ("outcome", "", "done"), BEGUN], GOES_ON),
        ([BEGUN, ("plan", "", "four steps")], GOES_ON),
        ([BEGUN, ("outcome", "", "done")], HAD_ENDED),
        ([BEGUN, ("parameters", "", "gain = 2.0 was set")], HAD_ENDED),
        ([BEGUN, ("command", "2", "the next")], HAD_ENDED),
    ],
)
def test_once_it_has_begun_the_manager_is_asked_what_it_does(
    events: list[tuple[str, str, str] | None], words: str
) -> None:
    sending, manager = follow.Sending("1"), Manager(*events)
    sending.begin()
    assert not sending.withdraw()
    assert sending.interrupted(manager) == words
    assert words is not NOT_KNOWN or None in events or manager.asked > 1


class Busy(Manager):
    """A manager in which a change waits for another command, until it is ``released``; then it refuses the change."""

    def __init__(self) -> None:
        super().__init__()
        self.released = threading.Event()

    def events(self, since: int = 0) -> Iterator[Event]:
        return iter(())

    def change(self, change: dict[str, Any], begin: Callable[[], object] = lambda: None) -> Outcome:
        begin()
        self._events = (OTHER, ("waiting", change["id"], "`b` waits for `a`"))
        assert self.released.wait(60)
        return Outcome(outcome="refused", because="the system is locked")


def test_dev_knows_what_becomes_of_the_swaps_that_it_has_asked_for() -> None:
    manager, refused = Busy(), list[str | None]()
    changes = Changes(manager, "talker.stride")
    asking = threading.Thread(target=lambda: refused.append(changes.carry_out({}, lambda _: None)), daemon=True)
    asking.start()
    until(lambda: bool(manager.log()))
    assert changes.interrupted() == [LATER]
    manager.released.set()
    asking.join(60)
    assert (refused, changes.interrupted()) == (["the system is locked"], [])


def here(system: Midstride, *words: str) -> Done:
    """The command in this process, also one that usually has its own."""
    with mock.patch("tests.cli.conftest.IN_PROCESS", {words[0]}):
        return system(*words)


def interrupted_after(monkeypatch: pytest.MonkeyPatch, path: str) -> None:
    """Ctrl-C comes right after the request for ``path`` has been sent whole."""
    send = client._UnixConnection.request

    def request(connection: Any, method: str, url: str, *arguments: Any) -> None:
        send(connection, method, url, *arguments)
        if method == "POST" and url.startswith(f"/api/v1{path}"):
            raise KeyboardInterrupt

    monkeypatch.setattr(client._UnixConnection, "request", request)


SET = ("param", "set", "talker", "gain", "2.0")


def events(system: Midstride, after: int = 0) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = system("log", "--json").json
    return [event for event in found if event["n"] > after]


def until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_a_parameter_whose_setting_is_interrupted_is_not_set_or_the_manager_goes_on(
    talker: Midstride, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = events(talker)[-1]["n"]
    with monkeypatch.context() as patched:
        patched.setattr(json, "dumps", interrupt)  # of the request
        done = talker(*SET)
    assert (done.status, NOTHING in done.err) == (130, True)
    assert events(talker, before) == []
    with monkeypatch.context() as patched:
        interrupted_after(patched, "/parameters")
        done = talker(*SET)
    assert done.status == 130 and (GOES_ON in done.err or HAD_ENDED in done.err)
    # The talker has no such parameter; that the manager says so shows that it was asked.
    until(lambda: [event["kind"] for event in events(talker, before)] == ["command", "parameters"])


def test_a_change_is_not_made_that_is_interrupted_while_the_plan_is_made_or_shown(
    talker: Midstride, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = events(talker)[-1]["n"]
    monkeypatch.setattr("midstride.cli.commands.change_commands.is_interactive", lambda: True)

    def no_answer(*_: Any, **__: Any) -> bool:
        raise click.Abort

    for place in ("midstride.cli.client.Client.plan", "click.confirm"):
        with monkeypatch.context() as patched:
            patched.setattr(place, no_answer if place == "click.confirm" else interrupt)
            done = talker("restart", "talker")
        assert (done.status, NOTHING in done.err) == (130, True)
    assert events(talker, before) == []


def test_a_lock_that_is_interrupted_may_be_there(talker: Midstride, monkeypatch: pytest.MonkeyPatch) -> None:
    for words in (("lock", "--reason", "a trial"), ("unlock",)):
        with monkeypatch.context() as patched:
            patched.setattr(json, "dumps", interrupt)
            done = talker(*words)
        assert (done.status, NOTHING in done.err) == (130, True)
        with monkeypatch.context() as patched:
            interrupted_after(patched, f"/{words[0]}")
            done = talker(*words)
        assert done.status == 130
        assert "Whether the system is locked now is not known here: `midstride status` shows it." in done.err
        until(lambda: (talker("status", "--json").json["lock"] is None) is (words[0] == "unlock"))  # noqa: B023


def test_down_that_is_interrupted_says_what_the_manager_does(
    midstride: Midstride, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted_down() -> str:
        done = here(midstride, "down")
        assert done.status == 130
        return done.err

    up = midstride("up", str(EXAMPLES / "talker" / "talker.stride"), "--backend", "sim", "--detach")
    assert up.status == 0, up.err
    with monkeypatch.context() as patched:
        patched.setattr(Client, "status", interrupt)
        assert "Nothing was stopped: the manager had not been asked yet." in interrupted_down()
    assert midstride("status").status == 0
    with monkeypatch.context() as patched:
        patched.setattr(shutdown, "wait_for_manager_exit", interrupt)
        said = interrupted_down()
    goes_on = "The manager is still stopping talker: `midstride status` shows what still runs."
    ended = "The manager of talker has ended: `midstride down --system talker` stops what is left, if anything is."
    assert goes_on in said or ended in said
    until(lambda: "no system is running" in midstride("status").err)


@pytest.mark.full
def test_down_that_waits_for_a_change_and_is_interrupted_says_so(
    midstride: Midstride, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The change is broken off at once; what it waits for is the end of an instance, which takes its time."""
    folder = shutil.copytree(EXAMPLES / "talker", tmp_path / "talker")
    program = (folder / "talker.py").read_text()
    slow = "import time\ncomp.on_stop(lambda: time.sleep(2))\ncomp.start()"
    (folder / "talker.py").write_text(program.replace("comp.start()", slow))
    up = midstride("up", str(folder / "talker.stride"), "--backend", "sim", "--detach")
    assert up.status == 0, up.err
    for path in ("/change", "/down"):
        with monkeypatch.context() as patched:
            interrupted_after(patched, path)
            command = ("restart", "talker", "--yes", "--json") if path == "/change" else ("down",)
            done = here(midstride, *command)
        assert done.status == 130
        if path == "/change":
            until(lambda: any("hand over" in each["words"] for each in midstride("log", "--json").json))
    assert "talker is carrying out `restart talker`, which is broken off and rolled back first …" in done.err
    waits = "The manager stops talker later: `down` waits for `restart talker`. `midstride status` shows what runs."
    assert waits in done.err
    until(lambda: "no system is running" in midstride("status").err)


@pytest.mark.parametrize("stop_on_exit", [False, True], ids=["detached", "--stop-on-exit"])
def test_up_that_is_interrupted_while_it_waits_for_the_first_rates(
    stop_on_exit: bool, midstride: Midstride, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = ("up", str(EXAMPLES / "talker" / "talker.stride"), "--backend", "sim")

    def brought_up(manager: Client, *_: Any) -> UpReport:
        """In a process that ends, so that the manager is no child of this one."""
        assert midstride.process(*command, "--detach").status == 0
        return manager.up()

    monkeypatch.setattr(up, "bring_up", brought_up)
    monkeypatch.setattr(up, "await_rates", interrupt)
    done = here(midstride, *command, "--stop-on-exit" if stop_on_exit else "--detach")
    if stop_on_exit:
        assert (done.status, "talker is down." in done.out) == (0, True)
        assert "no system is running" in midstride("status").err
    else:
        goes_on = "talker is up and keeps running: `midstride status` shows it, `midstride down` stops it."
        assert (done.status, goes_on in done.err) == (130, True)
        assert midstride("status").status == 0


def test_dev_ends_its_system_though_the_first_signal_is_lost_and_a_second_one_comes(
    midstride: Midstride, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The exception of the first is lost, as in a callback of an import; the second comes while the system stops."""
    file = str(EXAMPLES / "talker" / "talker.stride")

    def brought_up(manager: Client, *_: Any) -> UpReport:
        assert midstride.process("up", file, "--backend", "sim", "--detach").status == 0
        return manager.up()

    def saves(_: Any) -> Iterator[None]:
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGHUP)
        yield
        pytest.fail("it goes on")

    def stopped(system: str) -> Any:
        signal.raise_signal(signal.SIGHUP)
        return shutdown.shut_down(system)

    monkeypatch.setattr(dev, "bring_up", brought_up)
    monkeypatch.setattr(dev, "saves", saves)
    monkeypatch.setattr(dev, "shut_down", stopped)
    assert here(midstride, "dev", file, "--backend", "sim").status == 0
    assert "no system is running" in midstride("status").err
