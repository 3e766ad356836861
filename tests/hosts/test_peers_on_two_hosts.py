"""Control connections between components on two hosts: through the forwarded socket of a host process, both ways."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from midstride.errors import CallTimeout, ProtocolError, Unreachable
from midstride.runtime.hosts import wanted_connections
from midstride.wire.other_hosts import OtherHostAddress
from midstride.wire.sockets import SocketFolder
from midstride.wire.transport import FORWARDED, Connection
from tests.hosts.test_host_link import Far, launch, run, system


async def echo(connection: Connection) -> None:
    await connection.send(b"greeting")
    while (line := await connection.receive()) is not None:
        await connection.send(line)


async def answered(connection: Connection) -> None:
    assert await connection.receive() == b"greeting"
    await connection.send(b"x" * 200_000)
    assert await connection.receive() == b"x" * 200_000
    assert connection.peer == FORWARDED


def test_an_address_is_read_as_it_is_written() -> None:
    for address in (
        OtherHostAddress(Path("/run/x/arm.sock"), "/a/b"),
        OtherHostAddress(Path("/s#1/host.sock"), "b", elsewhere=True),
    ):
        assert OtherHostAddress.read(str(address)) == address
    assert OtherHostAddress.read("unix:/run/x.sock") is None


def test_components_of_two_hosts_reach_each_other(tmp_path: Path) -> None:
    async def body() -> None:
        far = Far(tmp_path)
        await far.run()
        async with system(tmp_path, far) as (backend, _, _):
            await backend.start(launch("there"))
            transport, component = backend.transport, SocketFolder(tmp_path / "components")
            stops = [await component.listen(name, echo) for name in ("here", "there")]
            # Components on one host reach each other as ever.
            assert transport.address("here", "other") == transport.address("here") == component.address("here")
            to_there = transport.address("there", seen_from="here")
            to_here = transport.address("here", seen_from="there")
            assert to_there == f"host:{tmp_path}/host.sock#there"
            assert to_here == f"manager:{tmp_path}/host.sock#here"
            for address in (to_there, to_here):
                connection = await component.connect(address)
                await answered(connection)
                connection.close()
            for stop in stops:
                stop()
            for address in (to_there, to_here):
                with pytest.raises(Unreachable):  # nothing listens there any more
                    await component.connect(address)

    run(body())


def test_a_way_that_is_closed_says_nothing_about_the_component(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wanted_connections, "BRING_SECONDS", 0.05)

    async def body() -> None:
        far = Far(tmp_path)
        await far.run()
        component = SocketFolder(tmp_path / "components")
        to_here = str(OtherHostAddress(tmp_path / "host.sock", "here", elsewhere=True))
        with pytest.raises(CallTimeout, match="here cannot be reached: the manager cannot"):
            await component.connect(to_here)
        async with system(tmp_path, far) as (backend, _, _):
            stop = await component.listen("here", echo)
            backend._links["arm"]._elsewhere = lambda _: asyncio.Event().wait()  # type: ignore[assignment,return-value]
            with pytest.raises(CallTimeout, match=r"the manager has not connected to here within 0\.05 s"):
                await component.connect(to_here)
            stop()
        with pytest.raises(CallTimeout, match="the way to here on its host is not open"):
            await component.connect(to_here)

    run(body())


@pytest.mark.parametrize(
    ("says", "words"),
    [(b'{"protocol": 99}\n', "speaks version 99"), (b"hello\n", "answers with something else"), (b"", "was closed")],
)
def test_what_is_no_host_process_is_said(tmp_path: Path, says: bytes, words: str) -> None:
    async def body() -> None:
        async def serve(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            writer.write(says)
            writer.close()

        server = await asyncio.start_unix_server(serve, tmp_path / "x.sock")
        with pytest.raises((ProtocolError, CallTimeout), match=words):
            await SocketFolder(tmp_path).connect(f"host:{tmp_path}/x.sock#a")
        server.close()

    run(body())


def test_the_clock_of_a_host_is_measured_over_its_link(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def body() -> None:
        far = Far(tmp_path)
        await far.run()
        async with system(tmp_path, far) as (backend, _, _):
            offset = await backend.clock_offset("arm")
            assert abs(offset.ahead) <= offset.uncertainty  # it is the clock of this machine
            assert backend._links["arm"].clock == offset
            assert (await backend.clock_offset("")).uncertainty == 0

    run(body())
