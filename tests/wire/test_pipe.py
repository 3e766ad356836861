"""The in-memory transport behaves as sockets do."""

from __future__ import annotations

import asyncio

import pytest

from midstride.errors import NodeError, Unreachable
from midstride.wire.pipe import PipeNetwork, pipe
from midstride.wire.transport import Connection


def test_frames_arrive_in_order_and_before_the_end() -> None:
    async def main() -> None:
        left, right = pipe()
        for frame in (b"one", b"two"):
            await left.send(frame)
        left.close()
        assert [await right.receive() for _ in range(4)] == [b"one", b"two", None, None]
        with pytest.raises(Unreachable):
            await right.send(b"three")
        with pytest.raises(Unreachable):
            await left.send(b"four")

    asyncio.run(main())


def test_closing_an_end_ends_what_waits_on_either() -> None:
    async def main() -> None:
        left, right = pipe()
        waiting = [asyncio.ensure_future(end.receive()) for end in (left, right)]
        await asyncio.sleep(0)
        left.close()
        assert await asyncio.gather(*waiting) == [None, None]

    asyncio.run(main())


def test_a_name_is_taken_until_its_listener_closes() -> None:
    async def serve(connection: Connection) -> None:
        await connection.send(b"hello")

    async def main() -> None:
        network = PipeNetwork()
        with pytest.raises(Unreachable, match="nothing listens at memory:talker"):
            await network.connect(network.address("talker"))
        stop_listening = await network.listen("talker", serve)
        assert network.present() == {"talker": "memory:talker"}
        with pytest.raises(NodeError, match="a component talker is running already"):
            await network.listen("talker", serve)
        connection = await network.connect("memory:talker")
        assert await connection.receive() == b"hello"
        stop_listening()
        assert network.present() == {}
        stop_later = await network.listen("talker", serve)
        stop_listening()  # its name is the other's by now
        assert network.present() == {"talker": "memory:talker"}
        stop_later()

    asyncio.run(main())
