"""The component's end: its greeting, its reports to every client, and the requests under way when it closes."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import msgspec
import pytest

from midstride.backends.simulator.virtual_loop import run
from midstride.errors import Unreachable
from midstride.wire.channel import Channel, ComponentReport
from midstride.wire.command_server import HELLO_TIMEOUT, UNDER_WAY, CommandServer, RequestHandler
from midstride.wire.commands import PingCommand
from midstride.wire.frames import (
    OLDEST,
    Hello,
    Reply,
    Request,
    StateChanged,
    decode_from_component,
    encode,
    encode_value,
)
from midstride.wire.pipe import PipeNetwork

from .support import GREETING, HELLO, REGISTRATION, BlockedConnection, done, eventually, server, state

Main = Callable[[CommandServer, PipeNetwork], Awaitable[None]]


def serving(main: Main, handler: RequestHandler = done) -> None:
    async def opened() -> None:
        network, commands = PipeNetwork(), server(handler)
        await commands.open(network)
        await main(commands, network)

    run(opened())


class Client:
    """A client and what was reported to it."""

    def __init__(self, channel: Channel, reports: list[ComponentReport]) -> None:
        self.channel = channel
        self.reports = reports


async def connected(network: PipeNetwork, token: str = "secret") -> Client:
    reports: list[ComponentReport] = []
    channel = await Channel.open(network, "memory:talker", token, timeout=1.0, report=reports.append)
    await asyncio.sleep(0.01)
    return Client(channel, reports)


def ping(id: str) -> bytes:
    return encode(Request(id=id, command=encode_value(PingCommand())))


def test_reports_go_to_every_client_and_the_newest_to_later_ones() -> None:
    async def main(commands: CommandServer, network: PipeNetwork) -> None:
        first = await connected(network)
        assert first.channel.greeting == GREETING and first.reports == []
        commands.report(state(1))
        commands.register(REGISTRATION)
        await asyncio.sleep(0.01)
        second = await connected(network, "of another manager")
        assert first.reports == [state(1), REGISTRATION] and second.reports == [REGISTRATION, state(1)]
        commands.report(state(2))
        await asyncio.sleep(0.01)
        assert first.reports[-1] == second.reports[-1] == state(2)
        first.channel.close()
        await asyncio.sleep(0.01)
        commands.report(state(3))
        await asyncio.sleep(0.01)
        assert second.reports[-1] == state(3) and first.reports[-1] == state(2)

    serving(main)


def test_each_client_has_its_own_token_and_its_own_replies() -> None:
    async def handler(request: Request, token: str) -> Reply:
        return Reply(id=request.id, revision=0, refused=token)

    async def main(commands: CommandServer, network: PipeNetwork) -> None:
        clients = [await connected(network, token) for token in ("mine", "yours")]
        replies = await asyncio.gather(
            *(client.channel.request(PingCommand(), timeout=1.0, id="same") for client in clients)
        )
        assert [reply.refused for reply in replies] == ["mine", "yours"]

    serving(main, handler)


def test_a_slow_request_does_not_hold_up_the_others() -> None:
    async def handler(request: Request, _: str) -> Reply:
        await asyncio.sleep(5.0 if request.id == "slow" else 0.0)
        return Reply(id=request.id, revision=1)

    async def main(commands: CommandServer, network: PipeNetwork) -> None:
        channel = (await connected(network)).channel
        slow = asyncio.ensure_future(channel.request(PingCommand(), timeout=10.0, id="slow"))
        await asyncio.sleep(0)
        assert (await channel.request(PingCommand(), timeout=1.0)).ok and not slow.done()
        assert (await slow).ok

    serving(main, handler)


def test_a_report_made_before_a_reply_arrives_before_it() -> None:
    async def main() -> None:
        async def handler(request: Request, _: str) -> Reply:
            commands.report(state(7))
            return Reply(id=request.id, revision=7)

        network, commands = PipeNetwork(), server(handler)
        await commands.open(network)
        client = await connected(network)
        reply = await client.channel.request(PingCommand(), timeout=1.0)
        assert client.reports == [state(reply.revision)]

    run(main())


def test_requests_under_way_are_answered_before_it_closes() -> None:
    async def handler(request: Request, _: str) -> Reply:
        await asyncio.sleep(0.5 if request.id == "answered" else 60.0)
        return Reply(id=request.id, revision=1)

    async def main(commands: CommandServer, network: PipeNetwork) -> None:
        client = await connected(network)
        answered, given_up = (
            asyncio.ensure_future(client.channel.request(PingCommand(), timeout=90.0, id=id))
            for id in ("answered", "given up")
        )
        await asyncio.sleep(0.1)
        begun = asyncio.get_running_loop().time()
        await commands.close(1.0)
        assert asyncio.get_running_loop().time() == begun + 1.0
        assert (await answered).ok
        with pytest.raises(Unreachable):
            await given_up
        assert client.channel.closed.is_set()
        with pytest.raises(Unreachable):
            await connected(network)

    serving(main, handler)


def test_with_nothing_under_way_it_closes_at_once_and_silent_connections_with_it() -> None:
    async def main(commands: CommandServer, network: PipeNetwork) -> None:
        client, silent = await connected(network), await network.connect("memory:talker")
        assert decode_from_component(await silent.receive() or b"") == GREETING
        begun = asyncio.get_running_loop().time()
        await commands.close(1.0)
        await client.channel.closed.wait()
        assert await silent.receive() is None
        assert asyncio.get_running_loop().time() == begun

    serving(main)


# -- clients that misbehave ------------------------------------------------------------------------


@pytest.mark.parametrize(
    "hello",
    [
        b"garbage",
        100_000 * b"[",
        encode(Hello(protocol=99, token="secret")),
        ping("1"),
        b'{"frame":"hello","protocol":1,"token":"\xff"}',
    ],
    ids=["garbage", "nested", "another version", "no greeting", "not UTF-8"],
)
def test_what_does_not_greet_as_a_client_gets_our_greeting_and_the_end(hello: bytes) -> None:
    async def main(commands: CommandServer, network: PipeNetwork) -> None:
        other = await connected(network)
        connection = await network.connect("memory:talker")
        await connection.send(hello)
        assert decode_from_component(await connection.receive() or b"") == GREETING
        assert await connection.receive() is None
        assert (await other.channel.request(PingCommand(), timeout=1.0)).ok

    serving(main)


def test_a_client_of_an_earlier_version_is_greeted_in_its_own() -> None:
    async def main(commands: CommandServer, network: PipeNetwork) -> None:
        connection = await network.connect("memory:talker")
        await connection.send(encode(Hello(protocol=OLDEST, token="secret")))
        greeting = decode_from_component(await connection.receive() or b"")
        assert greeting == msgspec.structs.replace(GREETING, protocol=OLDEST, place="")
        await connection.send(ping("1"))
        assert decode_from_component(await connection.receive() or b"") == Reply(id="1", revision=1)

    serving(main)


def test_what_has_its_default_is_not_sent_so_that_an_earlier_version_can_read_it() -> None:
    sent = encode(state(1))
    assert b'"shown"' not in sent and b'"shown":false' in encode(
        StateChanged(state=msgspec.structs.replace(state(1).state, shown=False))
    )


def test_garbage_after_the_greeting_ends_that_connection_alone() -> None:
    async def main(commands: CommandServer, network: PipeNetwork) -> None:
        other = await connected(network)
        for garbage in (b"garbage", HELLO, b'{"frame":"request","id":"1","command":{},"colour":"red"}'):
            connection = await network.connect("memory:talker")
            await connection.send(HELLO)
            await connection.receive()
            await connection.send(garbage)
            assert await connection.receive() is None
        assert (await other.channel.request(PingCommand(), timeout=1.0)).ok

    serving(main)


def test_a_connection_that_says_nothing_is_closed() -> None:
    async def main(commands: CommandServer, network: PipeNetwork) -> None:
        connection = await network.connect("memory:talker")
        assert decode_from_component(await connection.receive() or b"") == GREETING
        assert await connection.receive() is None
        assert asyncio.get_running_loop().time() == HELLO_TIMEOUT

    serving(main)


def blocked(main: Callable[[CommandServer, BlockedConnection], Awaitable[None]], *requests: bytes) -> None:
    """Serve a client that has greeted and sent ``requests``, and reads only what the test lets through."""

    async def opened() -> None:
        network, commands = PipeNetwork(), server()
        await commands.open(network)
        connection = BlockedConnection(HELLO, *requests)
        network.serve(network.listeners["talker"], connection)
        connection.let_through(1)
        await eventually(lambda: connection.sent)
        assert decode_from_component(connection.sent.pop()) == GREETING
        await asyncio.sleep(0.01)
        await main(commands, connection)

    run(opened())


def test_a_client_that_does_not_read_gets_the_newest_state_and_the_registration_when_it_does() -> None:
    async def main(commands: CommandServer, connection: BlockedConnection) -> None:
        for revision in range(100_000):
            commands.report(state(revision))
            if revision in (10, 20):
                await asyncio.sleep(0.01)
            if revision == 50:
                commands.register(REGISTRATION)
        connection.let_through(1_000)
        await asyncio.sleep(0.01)
        # The first one was being sent when the client stopped to read.
        assert [decode_from_component(line) for line in connection.sent] == [state(10), state(99_999), REGISTRATION]
        connection.sent.clear()
        commands.report(state(100_000))
        await asyncio.sleep(0.01)
        assert [decode_from_component(line) for line in connection.sent] == [state(100_000)]

    blocked(main)


def test_requests_of_a_client_that_does_not_read_are_not_read_either() -> None:
    requests = [ping(str(n)) for n in range(5 * UNDER_WAY)]

    async def main(commands: CommandServer, connection: BlockedConnection) -> None:
        assert connection.unread == 4 * UNDER_WAY
        connection.let_through(UNDER_WAY)
        await asyncio.sleep(0.01)
        assert connection.unread == 3 * UNDER_WAY
        connection.let_through(5 * UNDER_WAY)
        await asyncio.sleep(0.01)
        replies = [decode_from_component(line) for line in connection.sent]
        assert [reply.id for reply in replies if isinstance(reply, Reply)] == [str(n) for n in range(5 * UNDER_WAY)]

    blocked(main, *requests)


def test_a_client_that_does_not_read_does_not_keep_the_component_from_ending() -> None:
    async def main(commands: CommandServer, connection: BlockedConnection) -> None:
        begun = asyncio.get_running_loop().time()
        await commands.close(1.0)
        assert asyncio.get_running_loop().time() == begun + 1.0
        await connection.closed.wait()

    blocked(main, ping("1"))


def test_a_client_that_is_gone_while_it_has_too_many_requests_under_way_is_forgotten() -> None:
    async def main(commands: CommandServer, connection: BlockedConnection) -> None:
        connection.fail = True
        connection.let_through(1)
        await connection.closed.wait()

    blocked(main, *(ping(str(n)) for n in range(2 * UNDER_WAY)))
