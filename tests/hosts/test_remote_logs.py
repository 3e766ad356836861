"""The logs of components on other hosts are copied as far as they are asked for."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from midstride.cli.remote_logs import RemoteLogs
from midstride.runtime.hosts.host_service import HostService
from midstride.runtime.workspace import Workspace
from tests.hosts.test_host_link import ORDER, Platform, run


def test_what_is_new_is_copied_and_what_was_shortened_is_copied_again(tmp_path: Path) -> None:
    async def body() -> None:
        workspace, far = Workspace(tmp_path / "home"), tmp_path / "far"
        for folder in (workspace.path, workspace.path / "hosts", far):
            folder.mkdir()
        platform = Platform(far)
        service = HostService(platform, ORDER, directory=far, logs=far, version="1", idle=60.0)
        serving = asyncio.ensure_future(service.serve(workspace.path / "hosts" / "arm.sock"))
        while not (workspace.path / "hosts" / "arm.sock").exists():
            await asyncio.sleep(0.001)
        logs = RemoteLogs(workspace, lambda stem: stem == "talker")
        (far / "talker.log").write_text("one\n")
        (far / "other.log").write_text("not asked for\n")
        await asyncio.to_thread(logs.refresh)
        copied = workspace.logs / "arm" / "talker.log"
        assert copied.read_text() == "one\n" and list(copied.parent.iterdir()) == [copied]
        with (far / "talker.log").open("a") as file:
            file.write("two\n")
        await asyncio.to_thread(logs.refresh)
        assert copied.read_text() == "one\ntwo\n"
        (far / "talker.log").write_text("new\n")
        await asyncio.to_thread(logs.refresh)
        assert copied.read_text() == "new\n" and logs.problems == {}
        (workspace.logs / "talker.log").write_text("of an instance here that has the name of an earlier one there\n")
        await asyncio.to_thread(logs.refresh)
        assert (workspace.logs / "talker.log").read_text().startswith("of an instance here")
        serving.cancel()
        await asyncio.gather(serving, return_exceptions=True)
        logs.close()

    run(body())


@pytest.mark.parametrize("answer", [b"", b"{}\n", b'{"frame": "host"}\n'])
def test_a_host_that_does_not_answer_is_named(tmp_path: Path, answer: bytes) -> None:
    async def body() -> None:
        workspace = Workspace(tmp_path)
        (tmp_path / "hosts").mkdir()

        async def accepted(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            writer.write(answer)
            writer.close()

        server = await asyncio.start_unix_server(accepted, tmp_path / "hosts" / "arm.sock")
        logs = RemoteLogs(workspace, lambda _: True)
        await asyncio.to_thread(logs.refresh)
        assert list(logs.problems) == ["arm"]
        server.close()

    run(body())
