"""Unix sockets: names, stale files, other users, and clients that stop to read."""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import stat
import subprocess
import sys
import textwrap
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path

import msgspec
import pytest

from midstride.backends.processes import listens
from midstride.errors import CallTimeout, ManagerError, NodeError, ProtocolError, Unreachable
from midstride.wire import channel, sockets
from midstride.wire.channel import Channel
from midstride.wire.command_server import CommandServer
from midstride.wire.commands import PingCommand
from midstride.wire.folders import COMPONENTS, workspace_folder
from midstride.wire.frames import Hello, StateChanged, decode_from_component
from midstride.wire.sockets import SocketFolder
from midstride.wire.transport import Connection
from tests.process_name import named

from .support import GREETING, HELLO, descriptors_left, done, eventually, full_socket, server, state


async def echo(connection: Connection) -> None:
    """Send every frame back."""
    while (frame := await connection.receive()) is not None:
        await connection.send(frame)


async def says(connection: Connection, frame: bytes = b"hello") -> bool:
    """Whether an echo listens at the other end."""
    await connection.send(frame)
    found = await connection.receive() == frame
    connection.close()
    return found


def in_folder(path: Path, main: Callable[[SocketFolder], Awaitable[None]]) -> None:
    async def bounded() -> None:
        await asyncio.wait_for(main(SocketFolder(path)), 30.0)

    asyncio.run(bounded())


# -- names -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("instance", ["talker", "front/left/camera", "/front/camera", "a.b-c %2F ü", "n" * 240])
def test_any_name_is_found_under_its_address(tmp_path: Path, instance: str) -> None:
    async def main(folder: SocketFolder) -> None:
        assert folder.present() == {}
        stop_listening = await folder.listen(instance, echo)
        name = instance.strip("/")
        assert folder.present() == {name: folder.address(instance)}
        assert await says(await folder.connect(folder.address(name)))
        stop_listening()
        assert folder.present() == {} and list(folder.folder.iterdir()) == []
        with pytest.raises(Unreachable, match="nothing listens at unix:"):
            await folder.connect(folder.address(name))

    in_folder(tmp_path / COMPONENTS, main)


def test_a_connection_shows_whether_the_component_itself_is_at_the_other_end(tmp_path: Path) -> None:
    """A program that forwards a socket is another process; so its end is not that of the component."""

    async def main(folder: SocketFolder) -> None:
        for pid, direct in ((os.getpid(), True), (os.getppid(), False)):
            component = CommandServer(msgspec.structs.replace(GREETING, pid=pid), done)
            await component.open(folder)
            channel = await Channel.open(folder, folder.address("talker"), "secret", timeout=1.0)
            assert channel.direct is direct
            channel.close()
            await component.close(0.0)

    in_folder(tmp_path / COMPONENTS, main)


def test_a_process_with_a_name_that_is_no_utf_8_is_recognized(tmp_path: Path) -> None:
    async def main(folder: SocketFolder) -> None:
        stop_listening = await folder.listen("talker", echo)
        with named("regelung_motorü"):
            connection = await folder.connect(folder.address("talker"))
            assert connection.peer == os.getpid()
        assert await says(connection)
        stop_listening()

    in_folder(tmp_path / COMPONENTS, main)


def test_of_a_connection_that_has_been_closed_the_process_is_not_known(tmp_path: Path) -> None:
    """Such is one whose program accepts it and cannot pass it on: a client of it tries again."""

    async def main(folder: SocketFolder) -> None:
        stop_listening = await folder.listen("talker", echo)
        connection = await folder.connect(folder.address("talker"))
        connection.close()
        await asyncio.sleep(0)  # the transport closes its socket in the loop
        assert connection.peer is None
        with pytest.raises(Unreachable, match="closed the connection without a greeting"):
            await channel._greet(connection, "talker", Hello(protocol=1, token=""))
        stop_listening()

    in_folder(tmp_path / COMPONENTS, main)


def test_a_path_may_be_longer_than_the_107_bytes_of_a_socket(tmp_path: Path) -> None:
    deep = tmp_path / ("d" * 100) / ("e" * 100)

    async def main(folder: SocketFolder) -> None:
        stop_listening = await folder.listen("talker", echo)
        assert len(folder.address("talker")) > 200
        assert await says(await folder.connect(folder.address("talker")))
        stop_listening()

    in_folder(deep, main)


def test_a_name_too_long_for_a_file_is_refused(tmp_path: Path) -> None:
    async def main(folder: SocketFolder) -> None:
        with pytest.raises(NodeError, match=r"cannot open the control socket .*File name too long"):
            await folder.listen("n" * 300, echo)
        assert list(tmp_path.iterdir()) == [], "something is left behind"
        with pytest.raises(Unreachable):
            await folder.connect(folder.address("n" * 300))

    in_folder(tmp_path, main)


def test_a_folder_that_cannot_be_created_is_an_error_with_its_reason(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a folder")

    async def main(folder: SocketFolder) -> None:
        with pytest.raises(NodeError, match=r"cannot open the control socket .*Not a directory"):
            await folder.listen("talker", echo)

    in_folder(tmp_path / "file" / COMPONENTS, main)


def test_other_files_are_no_components(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("")
    assert SocketFolder(tmp_path).present() == {}


def test_only_the_user_may_open_the_socket_unless_the_folder_is_shared(tmp_path: Path) -> None:
    async def mode_of(path: Path) -> int:
        folder = SocketFolder(path)
        stop_listening = await folder.listen("talker", echo)
        mode = stat.S_IMODE((path / "talker.sock").stat().st_mode)
        stop_listening()
        return mode

    private, shared = tmp_path / "private", tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o770)
    assert asyncio.run(mode_of(private)) == 0o600 and asyncio.run(mode_of(shared)) == 0o660
    assert stat.S_IMODE(private.stat().st_mode) == 0o700


# -- one component of a name -----------------------------------------------------------------------


def test_a_second_listener_of_a_name_is_refused_and_the_first_goes_on(tmp_path: Path) -> None:
    async def main(folder: SocketFolder) -> None:
        stop_listening = await folder.listen("talker", echo)
        with pytest.raises(NodeError, match=r"a component talker is running already in demo; .*another name"):
            await folder.listen("talker", echo)
        assert await says(await folder.connect(folder.address("talker")))
        assert len(list(folder.folder.iterdir())) == 1
        stop_listening()

    in_folder(tmp_path / "demo" / COMPONENTS, main)


def test_what_is_found_under_a_name_listens_already(tmp_path: Path) -> None:
    with SocketFolder(tmp_path)._bind(tmp_path / "talker.sock"), raw(tmp_path / "talker.sock"):
        pass


def test_of_many_that_start_at_once_one_gets_the_name(tmp_path: Path) -> None:
    async def main(folder: SocketFolder) -> None:
        results = await asyncio.gather(*(folder.listen("talker", echo) for _ in range(20)), return_exceptions=True)
        (stop_listening,) = [result for result in results if not isinstance(result, NodeError)]
        assert not isinstance(stop_listening, BaseException)
        assert await says(await folder.connect(folder.address("talker")))
        stop_listening()

    in_folder(tmp_path, main)


LISTENER = """
import asyncio, sys
from pathlib import Path
from midstride.wire.sockets import SocketFolder

async def serve(connection):
    pass

async def main():
    await SocketFolder(Path(sys.argv[1])).listen("talker", serve)
    print("listening", flush=True)
    await asyncio.sleep(60)

asyncio.run(main())
"""


@contextlib.contextmanager
def other_process(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process that listens as `talker`."""
    with subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(LISTENER), str(folder)], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None and process.stdout.readline() == "listening\n"
        try:
            yield process
        finally:
            process.kill()


def test_the_socket_of_a_killed_process_is_replaced(tmp_path: Path) -> None:
    with other_process(tmp_path) as process:
        process.kill()
        process.wait()

    async def main(folder: SocketFolder) -> None:
        assert folder.present() == {"talker": folder.address("talker")}
        with pytest.raises(Unreachable, match=r"nothing listens at .*Connection refused"):
            await folder.connect(folder.address("talker"))
        stop_listening = await folder.listen("talker", echo)
        assert await says(await folder.connect(folder.address("talker")))
        stop_listening()

    in_folder(tmp_path, main)


def test_a_component_with_too_many_connections_waiting_is_there_and_does_not_block_anyone(tmp_path: Path) -> None:
    async def main(folder: SocketFolder) -> None:
        with pytest.raises(CallTimeout, match="accepts no connection: its process is stopped or overloaded"):
            await folder.connect(folder.address("talker"))
        assert await listens(folder, "talker")
        with pytest.raises(NodeError, match="running already"):
            await folder.listen("talker", echo)

    with full_socket(tmp_path / "talker.sock"):
        in_folder(tmp_path, main)


def test_a_component_that_accepts_the_waiting_ones_in_time_is_connected(tmp_path: Path) -> None:
    async def main(folder: SocketFolder) -> None:
        connecting = asyncio.ensure_future(folder.connect(folder.address("talker")))
        await asyncio.sleep(0.1)
        assert not connecting.done()
        full.accept()[0].close()
        (await connecting).close()

    with full_socket(tmp_path / "talker.sock") as full:
        in_folder(tmp_path, main)


@pytest.mark.parametrize("left", [0, 1], ids=["for the socket", "for its path"])
def test_without_a_descriptor_left_nothing_is_reached_and_nothing_is_gone(tmp_path: Path, left: int) -> None:
    async def main(folder: SocketFolder) -> None:
        stop_listening = await folder.listen("talker", echo)
        words = "cannot be reached from here: Too many open files"
        with descriptors_left(left), pytest.raises(CallTimeout, match=words):
            await folder.connect(folder.address("talker"))
        assert await says(await folder.connect(folder.address("talker")))
        stop_listening()

    in_folder(tmp_path / COMPONENTS, main)


def test_what_other_threads_open_while_it_is_bound_does_not_matter(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The socket is bound to a name in /proc/self/fd, whose descriptor another file has by now."""
    with contextlib.ExitStack() as opened:
        bind = SocketFolder._bind

        def then_opened(folder: SocketFolder, path: Path) -> socket.socket:
            listening = bind(folder, path)
            while opened.enter_context(open(os.devnull, "rb")).fileno() < listening.fileno() + 10:
                pass
            return listening

        async def main(folder: SocketFolder) -> None:
            stop_listening = await folder.listen("talker", echo)
            assert await says(await folder.connect(folder.address("talker")))
            stop_listening()
            assert not folder.present()

        monkeypatch.setattr(SocketFolder, "_bind", then_opened)
        in_folder(tmp_path, main)


def test_a_listener_does_not_remove_the_socket_of_its_successor(tmp_path: Path) -> None:
    async def main(folder: SocketFolder) -> None:
        stop_first = await folder.listen("talker", echo)
        (tmp_path / "talker.sock").unlink()  # someone has cleaned up
        stop_second = await folder.listen("talker", echo)
        stop_first()
        assert await says(await folder.connect(folder.address("talker")))
        stop_second()
        assert folder.present() == {}

    in_folder(tmp_path, main)


def test_a_lock_that_is_never_released_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sockets, "LOCK_TIMEOUT", 0.0)

    async def main(folder: SocketFolder) -> None:
        async with sockets.locked(tmp_path):
            with pytest.raises(NodeError, match="another process holds the lock of"):
                await folder.listen("talker", echo)
        (await folder.listen("talker", echo))()

    in_folder(tmp_path, main)


# -- users -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("user", "accepted"), [("own", True), ("root", True), ("folder's", True), ("another", False)])
def test_other_users_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, user: str, accepted: bool) -> None:
    monkeypatch.setattr(os, "getuid", lambda: 1234)
    uids = {"own": 1234, "root": 0, "folder's": tmp_path.stat().st_uid, "another": 4321}
    monkeypatch.setattr(sockets, "_credentials", lambda _: (1, uids[user]))

    async def main(folder: SocketFolder) -> None:
        commands = server()
        await commands.open(folder)
        opening = Channel.open(folder, folder.address("talker"), "secret", timeout=20.0)
        if accepted:
            channel = await opening
            assert (await channel.request(PingCommand(), timeout=20.0)).ok
            channel.close()
        else:
            with pytest.raises(Unreachable, match="without a greeting: it may accept other users only"):
                await opening
        await commands.close(1.0)

    in_folder(tmp_path, main)


def test_the_kernel_names_the_peers_user() -> None:
    left, right = socket.socketpair()
    with left, right:
        assert sockets._credentials(left) == (os.getpid(), os.getuid())


# -- frames ----------------------------------------------------------------------------------------


def raw(path: Path) -> socket.socket:
    connection = socket.socket(socket.AF_UNIX)
    connection.connect(str(path))
    return connection


def received(folder: Path, data: bytes) -> list[bytes | str | None]:
    """What a component receives of ``data``, after which its client is gone: frames, an error, the end."""
    found: list[bytes | str | None] = []

    async def serve(connection: Connection) -> None:
        while not found or isinstance(found[-1], bytes):
            try:
                found.append(await connection.receive())
            except ProtocolError as error:
                found.append(str(error))

    async def main(sockets_: SocketFolder) -> None:
        stop_listening = await sockets_.listen("talker", serve)
        with raw(folder / "talker.sock") as client:
            client.sendall(data)
        await eventually(lambda: found and not isinstance(found[-1], bytes))
        stop_listening()

    in_folder(folder, main)
    return found


def test_half_a_line_is_no_frame(tmp_path: Path) -> None:
    assert received(tmp_path, b'{"frame": 1}\n\n{"half": ') == [b'{"frame": 1}', b"", None]


def test_a_frame_that_is_too_long_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sockets, "LONGEST_FRAME", 1000)
    assert received(tmp_path, b"x" * 1000 + b"\n" + b"y" * 1001 + b"\n") == [
        b"x" * 1000,
        "it sent a frame of more than 1000 bytes",
    ]


def test_a_client_that_stops_to_read_costs_the_component_one_state(tmp_path: Path) -> None:
    """It gets those that the kernel took and, when it reads again, the newest; none of the thousands in between."""

    async def main(folder: SocketFolder) -> None:
        commands = server()
        await commands.open(folder)
        stopped = raw(tmp_path / "talker.sock")
        stopped.sendall(HELLO + b"\n")
        other = await Channel.open(folder, folder.address("talker"), "secret", timeout=20.0)
        for revision in range(20_001):
            commands.report(state(revision))
            await asyncio.sleep(0)
        assert (await other.request(PingCommand(), timeout=20.0)).ok
        stopped.setblocking(False)
        reader, writer = await asyncio.open_unix_connection(sock=stopped)
        greeting = msgspec.structs.replace(GREETING, place=folder.cut_lock("").place)
        assert decode_from_component(await reader.readline()) == greeting
        revisions = [-1]
        while revisions[-1] != 20_000:
            frame = decode_from_component(await reader.readline())
            assert isinstance(frame, StateChanged)
            revisions.append(frame.state.revision)
        assert revisions == sorted(revisions)
        assert len(revisions) < 10_000, "every state was kept for it"
        other.close()
        writer.close()
        await commands.close(1.0)

    in_folder(tmp_path, main)


def test_a_request_to_a_stopped_component_is_not_sent_after_its_time_out(tmp_path: Path) -> None:
    async def main(folder: SocketFolder) -> None:
        go = asyncio.Event()
        found: list[bytes] = []

        async def serve(connection: Connection) -> None:
            await go.wait()
            while (frame := await connection.receive()) is not None:
                found.append(frame[:10])

        stop_listening = await folder.listen("talker", serve)
        connection = await folder.connect(folder.address("talker"))
        large = asyncio.ensure_future(connection.send(b"1" * 50_000_000))
        given_up = asyncio.ensure_future(connection.send(b"2"))
        kept = asyncio.ensure_future(connection.send(b"3"))
        for request in (large, given_up):
            for _ in range(100):
                await asyncio.sleep(0)
            assert not (request.done() or kept.done())
            request.cancel()
            await asyncio.wait({request})
        go.set()
        await kept
        await eventually(lambda: len(found) == 2)
        assert found == [b"1" * 10, b"3"], "a frame that was begun is finished, one that was not is not sent"
        connection.close()
        stop_listening()

    in_folder(tmp_path, main)


def test_the_end_of_the_other_process_is_the_end_of_the_connection(tmp_path: Path) -> None:
    with other_process(tmp_path) as process:

        async def main(folder: SocketFolder) -> None:
            connection = await folder.connect(folder.address("talker"))
            process.kill()
            assert await connection.receive() is None
            with pytest.raises(Unreachable, match="the control connection is closed"):
                await _send_until_refused(connection)

        in_folder(tmp_path, main)


async def _send_until_refused(connection: Connection) -> None:
    while True:
        await connection.send(b"x")


# -- the workspace ---------------------------------------------------------------------------------


def test_workspaces_are_private_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    folder = workspace_folder("demo")
    assert folder == tmp_path / "midstride" / "demo"
    assert stat.S_IMODE(folder.stat().st_mode) == stat.S_IMODE(folder.parent.stat().st_mode) == 0o700
    folder.chmod(0o777)
    workspace_folder("demo")
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700, "open to everyone"
    folder.chmod(0o770)
    workspace_folder("demo")
    assert stat.S_IMODE(folder.stat().st_mode) == 0o770, "the owner has opened it to the group"
    for name in ("", "../demo", "a/b", "1st", ".", "a\n"):
        with pytest.raises(ManagerError, match="cannot name a running system"):
            workspace_folder(name)


def test_without_a_runtime_folder_the_workspace_is_in_the_temporary_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path))
    assert workspace_folder("demo") == tmp_path / f"midstride-{os.getuid()}" / "demo"


@pytest.mark.parametrize(
    ("mode", "named", "accepted"),
    [(0o700, True, False), (0o770, True, True), (0o777, True, False), (0o770, False, False)],
)
def test_the_folder_of_another_user_is_used_only_where_it_is_shared_and_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mode: int, named: bool, accepted: bool
) -> None:
    """In the temporary folder, where all may write, another user could have made it to pass for a component."""
    uid = os.getuid()
    root = tmp_path / "midstride" if named else tmp_path / f"midstride-{uid + 1}"
    (root / "demo").mkdir(parents=True)
    for folder in (root, root / "demo"):
        folder.chmod(mode)
    if named:
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    else:
        monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
        monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr(os, "getuid", lambda: uid + 1)
    if accepted:
        assert workspace_folder("demo") == root / "demo"
    else:
        with pytest.raises(ManagerError, match="belongs to another user"):
            workspace_folder("demo")


def test_a_workspace_that_cannot_be_created_says_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "midstride").write_text("a file")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with pytest.raises(ManagerError, match=r"cannot create the folder .*set XDG_RUNTIME_DIR"):
        workspace_folder("demo")
