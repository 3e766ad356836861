"""The client of a manager: its answers as forms, one of another form, and a manager that cannot be reached."""

from __future__ import annotations

import json
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import pytest

from midstride.cli.client import Client
from midstride.cli.error_output import report
from midstride.errors import ManagerError, NoManager
from midstride.runtime.records.status_forms import Status
from midstride.runtime.workspace import Workspace
from tests.cli import statuses
from tests.cli.conftest import Midstride
from tests.wire.support import descriptors_left, full_socket


@contextmanager
def answering(body: bytes) -> Iterator[Client]:
    """A client of what gives every request that answer."""
    # The paths of sockets must be short, and those of pytest's temporary folders are long.
    with tempfile.TemporaryDirectory(prefix="ms", dir="/tmp") as folder, socket.socket(socket.AF_UNIX) as server:
        path = Path(folder) / "manager.sock"
        server.bind(str(path))
        server.listen()

        def serve() -> None:
            connection, _ = server.accept()
            with connection:
                connection.recv(65_536)
                connection.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n%b" % (len(body), body))

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield Client(path)
        thread.join()


def test_what_a_later_manager_adds_is_ignored() -> None:
    known = statuses.status(statuses.component("talker"))
    document: dict[str, Any] = msgspec.to_builtins(known)
    document["instances"][0]["colour"] = "green"
    with answering(json.dumps(document).encode()) as client:
        assert client.status() == known


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (
            b'{"valid": true}',
            "missing required field `system`): another version of Midstride has started the manager. `midstride up",
        ),
        (b'{"valid": 7}', "Expected `bool`, got `int` - at `$.valid`"),
        (b'{"valid": tr', "the manager exited before it answered"),
    ],
)
def test_an_answer_of_another_form_is_an_error_that_says_where(body: bytes, words: str) -> None:
    with answering(body) as client, pytest.raises(ManagerError) as raised:
        client.status()
    assert words in str(raised.value)


def test_the_form_has_all_that_the_manager_sends(talker: Midstride) -> None:
    """So `--json`, which prints the form, leaves nothing out, and writes numbers as the manager does."""
    found = json.loads(Client(Workspace(talker.runtime / "midstride" / "talker").socket).text("/view"))
    view = {"version", "manager", "n", "at", "phase", "change"}
    status = {name: value for name, value in found.items() if name not in view}
    assert json.dumps(msgspec.to_builtins(msgspec.convert(found, Status))) == json.dumps(status)
    assert talker("status", "--json").json.keys() == status.keys()


def test_a_manager_that_accepts_no_connection_does_not_answer_in_time(tmp_path: Path) -> None:
    """It has not exited: it may be stopped."""
    path = tmp_path / "manager.sock"
    with full_socket(path), pytest.raises(ManagerError, match=r"^the manager did not answer within 0\.2 s$"):
        Client(path).text("/view", timeout=0.2)


@pytest.mark.parametrize(
    ("ask", "words", "outcome"),
    [
        (lambda client: client.plan({}), "exited before it answered (.*); see", "refused"),
        (lambda client: client.change({"request": {}}), "what was asked for may have begun, or be done", "unknown"),
    ],
    ids=["plan", "change"],
)
def test_whether_a_manager_that_exits_has_begun_a_change_is_not_known(
    ask: Callable[[Client], object], words: str, outcome: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with answering(b"{") as client, pytest.raises(ManagerError, match=words) as raised:
        ask(client)
    assert report(raised.value, ["restart", "talker", "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["outcome"] == outcome


def test_a_manager_that_is_busy_for_a_moment_is_connected(tmp_path: Path) -> None:
    path = tmp_path / "manager.sock"

    def accept() -> None:
        time.sleep(0.1)
        full.accept()[0].close()
        full.accept()[0].close()  # that of the client, whose request is not answered

    with full_socket(path) as full:
        accepting = threading.Thread(target=accept)
        accepting.start()
        with pytest.raises(ManagerError, match="the manager exited before it answered"):
            Client(path).text("/view", timeout=20.0)
        accepting.join()


def test_without_a_descriptor_left_the_manager_is_not_said_to_have_exited(tmp_path: Path) -> None:
    words = "^the manager cannot be reached: Too many open files$"
    with descriptors_left(0), pytest.raises(ManagerError, match=words):
        Client(tmp_path / "manager.sock").text("/view")
    with pytest.raises(NoManager):
        Client(tmp_path / "manager.sock").text("/view")
