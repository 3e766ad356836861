"""The client's end, in virtual time, with the component's end in the test's hands."""

from __future__ import annotations

import asyncio
import gc
from collections.abc import Awaitable, Callable
from typing import Any

import msgspec
import pytest

from midstride.backends.simulator.virtual_loop import run
from midstride.errors import CallTimeout, ProtocolError, Unreachable
from midstride.wire.channel import Channel, ComponentReport
from midstride.wire.commands import PingCommand
from midstride.wire.frames import OLDEST, PROTOCOL, Hello, Reply, Request, decode_from_client, encode
from midstride.wire.pipe import PipeNetwork
from midstride.wire.transport import Connection

from .support import GREETING, REGISTRATION, BlockedConnection, state

ADDRESS = "memory:talker"


def talk(component: Callable[[Connection], Awaitable[None]], client: Callable[[PipeNetwork], Awaitable[None]]) -> None:
    """``component`` is the other end of the connection that ``client`` opens; what either raises fails the test."""

    async def main() -> None:
        network = PipeNetwork()
        over: asyncio.Future[None] = asyncio.get_running_loop().create_future()

        async def serve(connection: Connection) -> None:
            try:
                await component(connection)
                over.set_result(None)
            except BaseException as error:
                over.set_exception(error)

        await network.listen("talker", serve)
        await client(network)
        await asyncio.wait_for(over, 1.0)

    run(main())


async def greet(connection: Connection) -> Hello:
    await connection.send(encode(GREETING))
    hello = decode_from_client(await connection.receive() or b"")
    assert isinstance(hello, Hello)
    return hello


async def next_request(connection: Connection) -> Request:
    request = decode_from_client(await connection.receive() or b"")
    assert isinstance(request, Request)
    return request


async def opened(network: PipeNetwork, **options: Any) -> Channel:
    return await Channel.open(network, ADDRESS, "secret", timeout=1.0, **options)


def now() -> float:
    return asyncio.get_running_loop().time()


def test_requests_get_their_replies_in_whatever_order_these_come() -> None:
    async def component(connection: Connection) -> None:
        assert (await greet(connection)).token == "secret"
        first, second = await next_request(connection), await next_request(connection)
        assert (first.id, first.revision) == ("a", 7) and second.id and second.revision is None
        for request, revision in ((second, 2), (first, 1)):
            await connection.send(encode(Reply(id=request.id, revision=revision)))

    async def client(network: PipeNetwork) -> None:
        channel = await opened(network)
        assert channel.greeting == GREETING
        first = channel.request(PingCommand(), revision=7, timeout=1.0, id="a")
        second = channel.request(PingCommand(), timeout=1.0)
        assert [reply.revision for reply in await asyncio.gather(first, second)] == [1, 2]

    talk(component, client)


def test_reports_go_to_the_caller_and_the_end_is_reported_once() -> None:
    async def component(connection: Connection) -> None:
        await greet(connection)
        for frame in (REGISTRATION, state(1), state(2)):
            await connection.send(encode(frame))
        connection.close()

    async def client(network: PipeNetwork) -> None:
        reports: list[ComponentReport] = []
        ends: list[int] = []
        channel = await opened(network, report=reports.append, ended=lambda: ends.append(len(reports)))
        await channel.closed.wait()
        await asyncio.sleep(1)
        assert reports == [REGISTRATION, state(1), state(2)] and ends == [3]
        channel.close()
        assert ends == [3]

    talk(component, client)


def test_the_end_of_the_connection_fails_all_requests_under_way_at_once() -> None:
    async def component(connection: Connection) -> None:
        await greet(connection)
        for _ in range(2):
            await next_request(connection)
        await asyncio.sleep(0.25)
        connection.close()

    async def client(network: PipeNetwork) -> None:
        channel = await opened(network)
        begun = now()
        requests = [channel.request(PingCommand(), timeout=60.0) for _ in range(2)]
        for result in await asyncio.gather(*requests, return_exceptions=True):
            assert isinstance(result, Unreachable) and "talker is gone" in str(result)
        assert now() == begun + 0.25
        with pytest.raises(Unreachable, match="talker has closed"):
            await channel.request(PingCommand(), timeout=60.0)
        assert now() == begun + 0.25

    talk(component, client)


def test_an_end_while_a_request_is_being_sent_is_no_error_that_nothing_retrieves() -> None:
    async def component(connection: Connection) -> None:
        await greet(connection)
        await asyncio.sleep(0.25)
        connection.close()

    async def client(network: PipeNetwork) -> None:
        unretrieved: list[str] = []
        asyncio.get_running_loop().set_exception_handler(lambda _, context: unretrieved.append(context["message"]))
        channel = await opened(network)

        async def send(frame: bytes) -> None:
            await asyncio.sleep(0.5)
            raise Unreachable("it is gone")

        channel.connection.send = send  # type: ignore[method-assign]
        with pytest.raises(Unreachable, match="it is gone"):
            await channel.request(PingCommand(), timeout=60.0)
        gc.collect()
        assert unretrieved == []

    talk(component, client)


def test_garbage_ends_the_connection_with_its_reason() -> None:
    async def component(connection: Connection) -> None:
        await greet(connection)
        await next_request(connection)
        await connection.send(b"garbage")

    async def client(network: PipeNetwork) -> None:
        ends: list[bool] = []
        channel = await opened(network, ended=lambda: ends.append(True))
        with pytest.raises(Unreachable, match="talker is gone: not a frame of a component"):
            await channel.request(PingCommand(), timeout=60.0)
        await asyncio.sleep(0)
        assert ends == [True]

    talk(component, client)


def test_a_report_that_cannot_be_handled_ends_the_connection_and_is_logged() -> None:
    def report(_: ComponentReport) -> None:
        raise ZeroDivisionError("a bug")

    async def component(connection: Connection) -> None:
        await greet(connection)
        await next_request(connection)
        await connection.send(encode(state(1)))

    async def client(network: PipeNetwork) -> None:
        logged: list[dict[str, Any]] = []
        asyncio.get_running_loop().set_exception_handler(lambda _, context: logged.append(context))
        channel = await opened(network, report=report)
        with pytest.raises(Unreachable, match="internal error: ZeroDivisionError"):
            await channel.request(PingCommand(), timeout=60.0)
        assert [type(context["exception"]) for context in logged] == [ZeroDivisionError]

    talk(component, client)


def test_a_request_times_out_and_its_late_reply_is_dropped() -> None:
    async def component(connection: Connection) -> None:
        await greet(connection)
        late = await next_request(connection)
        await asyncio.sleep(3.0)
        await connection.send(encode(Reply(id=late.id, revision=1)))
        again = await next_request(connection)
        await connection.send(encode(Reply(id=again.id, revision=2)))

    async def client(network: PipeNetwork) -> None:
        channel = await opened(network)
        begun = now()
        with pytest.raises(CallTimeout, match="talker did not answer within 2 s"):
            await channel.request(PingCommand(), timeout=2.0, id="a")
        assert now() == begun + 2.0
        await asyncio.sleep(2.0)
        # The same id, as a repeated request has.
        assert (await channel.request(PingCommand(), timeout=2.0, id="a")).revision == 2
        assert now() == begun + 4.0
        with pytest.raises(CallTimeout):
            await channel.request(PingCommand(), timeout=2.0, id="b")
        await asyncio.sleep(0.1)
        assert channel._waiting == {}, "requests that get no reply are kept for ever"

    talk(component, client)


def test_a_component_that_reads_nothing_does_not_hold_up_a_request_beyond_its_time_out() -> None:
    async def main() -> None:
        connection = BlockedConnection()
        channel = Channel(connection, GREETING, lambda _: None, lambda: None)
        begun = now()
        with pytest.raises(CallTimeout):
            await channel.request(PingCommand(), timeout=2.0)
        assert now() == begun + 2.0
        under_way = asyncio.ensure_future(channel.request(PingCommand(), timeout=2.0))
        await asyncio.sleep(1.0)
        connection.let_through(1)
        connection.close()
        with pytest.raises(Unreachable):
            await under_way

    run(main())


def test_closing_it_fails_requests_and_reports_no_end() -> None:
    async def component(connection: Connection) -> None:
        await greet(connection)
        await next_request(connection)
        assert await connection.receive() is None, "the component does not see the end"

    async def client(network: PipeNetwork) -> None:
        ends: list[bool] = []
        channel = await opened(network, ended=lambda: ends.append(True))
        request = asyncio.ensure_future(channel.request(PingCommand(), timeout=60.0))
        await asyncio.sleep(0.1)
        channel.close()
        with pytest.raises(Unreachable, match="closed at this end"):
            await request
        await asyncio.sleep(1)
        assert ends == []

    talk(component, client)


def test_closing_it_leaves_nothing_that_reads() -> None:
    """Not even where the connection goes on to wait."""

    class Endless(BlockedConnection):
        async def receive(self) -> bytes | None:
            return await asyncio.Future()

    async def main() -> None:
        before = asyncio.all_tasks()
        channel = Channel(Endless(), GREETING, lambda _: None, lambda: None)
        await asyncio.sleep(0)
        channel.close()
        await asyncio.sleep(0)
        assert asyncio.all_tasks() == before

    run(main())


def test_closing_it_within_a_report_ends_the_reports() -> None:
    """Frames that have been received by then are in the connection's buffer, and can be read after it is closed."""

    async def main() -> None:
        connection = BlockedConnection(*(encode(state(revision)) for revision in range(3)))
        reports: list[ComponentReport] = []
        ends: list[bool] = []

        def report(frame: ComponentReport) -> None:
            reports.append(frame)
            channel.close()

        channel = Channel(connection, GREETING, report, lambda: ends.append(True))
        await connection.closed.wait()
        await asyncio.sleep(1)
        assert reports == [state(0)] and ends == []

    run(main())


def test_a_request_that_is_given_up_leaves_the_others() -> None:
    async def component(connection: Connection) -> None:
        await greet(connection)
        for _ in range(2):
            request = await next_request(connection)
            await asyncio.sleep(1.0)
            await connection.send(encode(Reply(id=request.id, revision=1)))

    async def client(network: PipeNetwork) -> None:
        channel = await opened(network)
        given_up, kept = (asyncio.ensure_future(channel.request(PingCommand(), timeout=60.0)) for _ in range(2))
        await asyncio.sleep(0.5)
        given_up.cancel()
        assert (await kept).ok and given_up.cancelled()

    talk(component, client)


# -- greetings -------------------------------------------------------------------------------------


def refused(component: Callable[[Connection], Awaitable[None]], error: type[Exception], words: str) -> None:
    """A client cannot open a channel to ``component``, and closes the connection."""
    ends: list[bytes | None] = []

    async def watched(connection: Connection) -> None:
        await component(connection)
        assert isinstance(decode_from_client(await connection.receive() or b""), Hello)
        ends.append(await connection.receive())

    async def client(network: PipeNetwork) -> None:
        with pytest.raises(error, match=words):
            await opened(network)
        await asyncio.sleep(1.0)
        assert ends == [None], "the connection stays open"

    talk(watched, client)


def test_a_component_that_does_not_greet_times_out() -> None:
    async def silent(_: Connection) -> None:
        pass

    refused(silent, CallTimeout, "memory:talker did not greet within 1 s")


def test_a_component_of_another_version_is_refused() -> None:
    async def newer(connection: Connection) -> None:
        await connection.send(encode(msgspec.structs.replace(GREETING, protocol=99)))

    refused(newer, ProtocolError, "talker speaks version 99 of the control protocol.*newer version.*use that one")


def test_a_component_of_an_earlier_version_is_spoken_to_in_its_own() -> None:
    async def main() -> None:
        network, hellos = PipeNetwork(), []

        async def earlier(connection: Connection) -> None:
            await connection.send(encode(msgspec.structs.replace(GREETING, protocol=OLDEST)))
            hello = decode_from_client(await connection.receive() or b"")
            assert isinstance(hello, Hello)
            hellos.append(hello.protocol)
            if hello.protocol != OLDEST:
                return connection.close()
            request = await next_request(connection)
            await connection.send(encode(Reply(id=request.id, revision=1)))

        await network.listen("talker", earlier)
        channel = await opened(network)
        assert channel.greeting.protocol == OLDEST and (await channel.request(PingCommand(), timeout=1.0)).ok
        assert hellos == [PROTOCOL, OLDEST]

    run(main())


def test_a_component_that_greets_in_another_version_each_time_is_refused() -> None:
    async def main() -> None:
        network, versions = PipeNetwork(), iter((OLDEST, PROTOCOL))

        async def fickle(connection: Connection) -> None:
            await connection.send(encode(msgspec.structs.replace(GREETING, protocol=next(versions))))

        await network.listen("talker", fickle)
        with pytest.raises(ProtocolError, match="talker greets in another version of the protocol each time"):
            await opened(network)

    run(main())


def test_what_does_not_greet_first_is_refused() -> None:
    async def early(connection: Connection) -> None:
        await connection.send(encode(state(1)))

    refused(early, ProtocolError, "not a greeting")


def test_a_connection_closed_without_a_greeting_says_why_that_may_be() -> None:
    async def closing(connection: Connection) -> None:
        await connection.receive()
        connection.close()

    async def client(network: PipeNetwork) -> None:
        with pytest.raises(
            Unreachable, match="closed the connection without a greeting: it may accept other users only"
        ):
            await opened(network)

    talk(closing, client)
