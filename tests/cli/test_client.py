"""The client of a manager: its answers as forms, and an answer that has another form."""

from __future__ import annotations

import json
import socket
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import pytest

from midstride.cli.client import Client
from midstride.errors import ManagerError
from midstride.runtime.status_forms import Status
from midstride.runtime.workspace import Workspace
from tests.cli import statuses
from tests.cli.conftest import Midstride


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
    document["components"][0]["colour"] = "green"
    with answering(json.dumps(document).encode()) as client:
        assert client.status() == known


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (
            b'{"valid": true}',
            "missing required field `violations`; if another version of Midstride started it, use that",
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
    found = Client(Workspace(talker.runtime / "midstride" / "talker").socket).get("/status")
    assert json.dumps(msgspec.to_builtins(msgspec.convert(found, Status))) == json.dumps(found)
    assert talker("status", "--json").json.keys() == found.keys()
