"""The manager's side on real ROS 2: processes found, watched, called, ended, and found again."""

from __future__ import annotations

import asyncio
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from midstride.backends.ros2 import dds_profiles, middleware
from midstride.backends.ros2.manager.component_containers import LoadRequest
from midstride.backends.ros2.manager.foreign_nodes import ForeignNodes
from midstride.errors import BackendError, CallTimeout, StartFailed, Unreachable
from midstride.foreign.page import GATES_FOLDER
from midstride.foreign.record import ForeignRecord
from midstride.lang import load_text
from midstride.model.component import KILL_AT_ONCE, StopTimes
from midstride.runtime.backend_protocol import Endpoints, Exited, Handle, Launch
from midstride.runtime.process.component_client import ComponentClient
from midstride.wire.commands import AttachCommand, AwaitWriteCommand, MeetCommand, PingCommand
from midstride.wire.environment import ENV_CONTROL, ENV_SYSTEM
from midstride.wire.folders import COMPONENTS, workspace_folder
from tests.acceptance.support import Starved
from tests.backends.ros2_support import (
    LISTENER,
    TALKER,
    Bare,
    Rig,
    alive,
    rig,
    run,
    shared_memory_of,
    until,
    until_async,
    without_midstride,
)
from tests.foreign.chat import chat
from tests.planting import plant

pytestmark = pytest.mark.ros2


def test_a_component_is_started_attached_heard_and_ended(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            greeting, registration = await r.start("talker", TALKER)
            assert greeting.pid == r.pid("talker")
            assert registration.endpoints == []
            assert sorted(registration.declaration.checked().outputs) == ["out"]
            await r.start("listener", LISTENER)
            await r.attach("talker", "out", "/chatter")
            await r.attach("listener", "in", "/chatter", peers=1)
            await r.modes("talker", talk="normal")
            await r.modes("listener", listen="normal")
            await until_async(lambda: r.shows_node("/talker"))
            await until_async(lambda: r.shows_node("/listener"))
            await until_async(lambda: r.shows_reader("/listener", "/chatter"))
            await until_async(lambda: r.shows_writer("/talker", "/chatter"))
            seen = await r.backend.endpoints()
            assert seen.publishers == (("/talker", "/chatter"),)
            assert seen.subscribers == (("/listener", "/chatter"),)
            before = (await r.link("listener", "in", "/chatter")).count

            async def more() -> bool:
                return (await r.link("listener", "in", "/chatter")).count > before + 20

            await until_async(more)
            await r.modes("talker", talk="degraded")
            assert (await r.detach("talker", "out", "/chatter")).acknowledged is True
            await until_async(lambda: r.shows_no_writer("/chatter"))
            pid = r.pid("talker")
            await r.backend.end("talker", StopTimes(0.0, 5.0))
            assert not alive(pid)
            assert r.exits == []  # an end that was requested is not reported
            assert "/talker" not in (await r.backend.endpoints()).nodes

    run(scenario())


@pytest.fixture
def short_lease(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Components that the graph drops 8 s after their death, not Fast DDS's 20 s, as a user's own profile may say."""
    if not middleware.of_this_process().fast_dds:
        return
    with Bare():  # this process has read the usual profile now, and keeps it
        major = dds_profiles.loaded_major()
    profile = (dds_profiles.PROFILES / f"fastdds{major}_localhost.xml").read_text(encoding="utf-8")
    lease = "<discovery_config><leaseDuration><sec>8</sec></leaseDuration><leaseAnnouncement><sec>2</sec>"
    own = tmp_path / "own.xml"
    own.write_text(profile.replace("<builtin>", f"<builtin>{lease}</leaseAnnouncement></discovery_config>"))
    assert major is not None
    monkeypatch.setenv(dds_profiles.PROFILE_VARIABLES[major], str(own))
    monkeypatch.setenv(dds_profiles.RANGE, "SYSTEM_DEFAULT")


@pytest.mark.full
@pytest.mark.usefixtures("short_lease")
def test_a_killed_component_is_known_at_once_however_long_the_graph_shows_it(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", TALKER)
            await until(lambda: "/talker" in graph_names(r))
            waiting = AwaitWriteCommand(timeout=30.0, port="out", topic="/none")
            calling = asyncio.ensure_future(r.client.read("talker", waiting))
            r.kill("talker")
            await until(lambda: r.exits)
            assert "/talker" in graph_names(r), "it was known by the graph alone"
            assert "/talker" not in (await r.backend.endpoints()).nodes
            assert (r.exits[0].instance, r.exits[0].status) == ("talker", -signal.SIGKILL)
            with pytest.raises(Exception, match="talker"):
                await asyncio.wait_for(calling, 20.0)
            with pytest.raises(Unreachable, match="talker"):
                await r.client.read("talker", PingCommand())
            await until(lambda: "/talker" not in graph_names(r), 30.0)

    run(scenario())


def graph_names(r: Rig) -> list[str]:
    """The nodes that the middleware shows, dead ones included."""
    return [f"{inside.rstrip('/')}/{name}" for name, inside in r.backend._node.get_node_names_and_namespaces()]


@pytest.mark.full
@pytest.mark.usefixtures("short_lease")
def test_endpoints_of_the_dead_are_left_out_and_their_readers_are_counted(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("listener", LISTENER)
            await r.attach("listener", "in", "/chatter")
            seen = ("/listener", "/chatter")
            assert await r.backend.lingering_readers("/chatter") == 0
            await until_async(lambda: r.shows_reader(*seen))
            r.kill("listener")
            await until(lambda: r.exits)
            r.exits.clear()
            assert await r.backend.lingering_readers("/chatter") == 1
            assert (await r.backend.endpoints()).subscribers == ()

            # Another one of that name lives, and is not attached: what the graph shows on the topic is the dead one's.
            await r.start("listener", LISTENER)
            await until_async(lambda: r.shows_node("/listener"))
            assert (await r.backend.endpoints()).subscribers == ()
            assert await r.backend.lingering_readers("/chatter") == 1
            await r.attach("listener", "in", "/chatter")
            await until_async(lambda: r.shows_reader(*seen))
            assert (await r.backend.endpoints()).subscribers == (seen,)
            assert await r.backend.lingering_readers("/chatter") == 1

            async def forgotten() -> bool:
                return bool(await r.backend.lingering_readers("/chatter") == 0)

            await until_async(forgotten, 30.0)
            assert (await r.backend.endpoints()).subscribers == (seen,)

    run(scenario())


def test_a_component_started_by_hand_is_left_out_once_its_connection_has_closed(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            (tmp_path / "talker.py").write_text(TALKER)
            environment = without_midstride() | {ENV_CONTROL: str(r.backend.transport.folder)}
            with subprocess.Popen([sys.executable, "talker.py"], cwd=tmp_path, env=environment) as process:
                try:
                    await r.welcome("talker")
                    await r.attach("talker", "out", "/chatter")
                    await until_async(lambda: r.shows_writer("/talker", "/chatter"))
                finally:
                    process.kill()
            r.backend.disconnected("talker")
            assert "/talker" in graph_names(r)
            assert (await r.backend.endpoints()) == Endpoints()
            with Bare("talker"):  # the name is not ignored, only what was there
                await until_async(lambda: r.shows_node("/talker"))

    run(scenario())


def test_a_name_that_is_taken_is_refused(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            with Bare("talker") as bare:
                await bare.until(lambda: "/talker" in graph_names(r))
                whose = r"whose it is, is not known: \w+ does not tell which process has a node"
                if middleware.of_this_process().fast_dds:
                    whose = rf"it is process {os.getpid()} \(`.*`\)"
                whose = f"a node /talker is running already: {whose}; end it"
                with pytest.raises(StartFailed, match=whose):
                    await r.launch("talker", TALKER)
            await until(lambda: "/talker" not in graph_names(r))
            await r.start("talker", TALKER)

    run(scenario())


def test_a_name_that_the_graph_forgot_to_drop_is_free(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            node = r.backend._node
            known = node.get_node_names_and_namespaces
            monkeypatch.setattr(node, "get_node_names_and_namespaces", lambda: [*known(), ("talker", "/")])
            assert "/talker" not in (await r.backend.endpoints()).nodes
            await r.start("talker", TALKER)
            await until_async(lambda: r.shows_node("/talker"))

    run(scenario())


@pytest.mark.full
def test_the_name_of_a_killed_component_can_be_used_again_at_once(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", TALKER)
            await until(lambda: "/talker" in graph_names(r))
            r.kill("talker")
            await until(lambda: r.exits)
            r.exits.clear()
            first = r.pid("talker")
            assert "/talker" in graph_names(r)
            greeting, _ = await r.start("talker", TALKER)
            assert "/talker" in graph_names(r)
            assert greeting.pid == r.pid("talker") != first
            assert (await r.client.observe("talker")).pid == greeting.pid

    run(scenario())


@pytest.mark.parametrize(
    ("source", "status", "words"),
    [
        ("import no_such_module_at_all", 1, "No module named 'no_such_module_at_all'"),
        ("raise SystemExit(7)", 7, ""),
        ("from midstride import Component\nComponent('talker').create_output('out', int)", 1, "out"),
    ],
)
def test_a_component_that_fails_on_its_way_up_is_reported_with_its_log(
    tmp_path: Path, source: str, status: int, words: str
) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.launch("talker", source)
            await until(lambda: r.exits)
            assert r.exits[0].status == status
            assert words in r.exits[0].log_tail
            assert r.client.life.latest("talker") is None

    run(scenario())


def test_a_program_that_is_not_there(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            with pytest.raises(StartFailed, match="no program no-such-program"):
                await r.backend.start(Launch("talker", "", ("no-such-program",), r.token, tmp_path))

    run(scenario())


@pytest.mark.parametrize("fault", ["its record", "its socket", "cancelled"])
def test_a_node_without_the_api_that_nobody_can_answer_for_does_not_run(
    fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[int] = []
    answering = ForeignNodes.started

    async def started_then(nodes: ForeignNodes, record: ForeignRecord, handle: Handle, *request: LoadRequest) -> None:
        assert handle.pid is not None and alive(handle.pid)
        started.append(handle.pid)
        if fault == "cancelled" and len(started) == 1:
            raise asyncio.CancelledError
        await answering(nodes, record, handle, *request)

    monkeypatch.setattr(ForeignNodes, "started", started_then)
    component = load_text(chat("none")).require().components["Talker"]

    async def scenario() -> None:
        async with rig(tmp_path) as r:
            blocked = Path(r.backend.transport.address("talker").removeprefix("unix:"))
            if fault == "its record":
                blocked = tmp_path / "components" / GATES_FOLDER / "talker.json"
            if fault != "cancelled":
                (blocked / "a file").mkdir(parents=True)
            sleeping = "import time; time.sleep(600)"
            with pytest.raises(asyncio.CancelledError if fault == "cancelled" else BackendError):
                await r.launch("talker", sleeping, foreign=component)
            assert not alive(started[0])
            if fault != "cancelled":
                shutil.rmtree(blocked)
            handle = await r.launch("talker", sleeping, foreign=component)  # its name is free
            assert handle.pid == started[1]

    run(scenario())


def test_calling_what_is_not_there(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            with pytest.raises(Unreachable, match="nobody"):
                await r.client.read("nobody", PingCommand())

    run(scenario())


@pytest.mark.full
def test_a_component_that_is_stopped_does_not_answer_in_time_but_answers_later(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", TALKER)
            channel = await r.channel("talker")
            r.kill("talker", signal.SIGSTOP)
            begun = time.monotonic()
            with pytest.raises(CallTimeout, match="talker"):
                await channel.request(PingCommand(), timeout=0.7)
            assert time.monotonic() - begun > 0.6
            r.kill("talker", signal.SIGCONT)
            assert (await channel.request(PingCommand(), timeout=10.0)).ok

    run(scenario())


def test_a_component_that_was_paused_answers_and_works_within_a_second(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", TALKER)
            await r.attach("talker", "out", "/chatter", gate="closed")
            await r.modes("talker", talk="normal")
            r.kill("talker", signal.SIGSTOP)
            await until(lambda: r.client.life.responsive("talker") is None)
            before = r.client.life.latest("talker")
            assert before is not None
            r.kill("talker", signal.SIGCONT)
            begun, starved = time.monotonic(), Starved(r.pid("talker"), os.getpid())
            state = await r.client.observe("talker")
            await until(lambda: r.client.life.responsive("talker"))
            assert state.functionalities["talk"].mode == "normal"
            while (await r.link("talker", "out", "/chatter")).gated <= before.state.ports["out"]["/chatter"].gated + 2:
                await asyncio.sleep(0.005)
            starved.look()
            assert time.monotonic() - begun < 1.0 + starved.seconds

    run(scenario())


def noted(send: Callable[[bytes], Awaitable[None]], sent: list[bytes]) -> Callable[[bytes], Awaitable[None]]:
    """The same; each frame that the socket has taken is in ``sent``."""

    async def send_and_note(frame: bytes) -> None:
        await send(frame)
        sent.append(frame)

    return send_and_note


@pytest.mark.full
def test_a_command_that_is_sent_again_is_carried_out_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The component is stopped while a command is sent, and sent again; going on, it finds several of it."""

    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", TALKER)
            revision = (await r.client.observe("talker")).revision
            channels = [await r.channel("talker"), await r.channel("talker")]
            sent: list[bytes] = []
            for channel in channels:
                plant(monkeypatch, channel.connection, "send", noted(channel.connection.send, sent))
            r.kill("talker", signal.SIGSTOP)
            command = AttachCommand(port="out", topic="/chatter")
            first, second = (
                asyncio.ensure_future(channel.request(command, id="once", revision=revision, timeout=30.0))
                for channel in channels
            )
            await until(lambda: len(sent) == len(channels))
            r.kill("talker", signal.SIGCONT)
            assert await first == await second
            assert (await first).ok
            state = await r.client.observe("talker")
            assert state.revision == revision + 1
            assert list(state.ports["out"]) == ["/chatter"]

    run(scenario())


@pytest.mark.full
def test_observing_does_not_wait_for_user_code(tmp_path: Path) -> None:
    sleeping = TALKER.replace("    global count\n", "    global count\n    __import__('time').sleep(600)\n")

    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", sleeping)
            await r.attach("talker", "out", "/chatter")
            await r.modes("talker", talk="normal")

            async def busy() -> bool:
                return (await r.client.observe("talker")).functionalities["talk"].busy is not None

            while not await busy():
                await asyncio.sleep(0.01)
            for _ in range(20):
                view = (await r.client.observe("talker")).functionalities["talk"]
                assert view.mode == "normal" and view.busy is not None

    run(scenario())


def test_a_later_manager_finds_the_component_again(tmp_path: Path) -> None:
    async def scenario() -> None:
        from midstride.backends.ros2 import create_backend

        async with rig(tmp_path) as r:
            await r.start("talker", TALKER)
            await r.attach("talker", "out", "/chatter")
            handle = r.handles["talker"]
            await r.backend.close()
            assert alive(r.pid("talker"))

            exits: list[Exited] = []
            later = create_backend(tmp_path / "components", logs=tmp_path / "later")
            await later.open(exits.append)
            try:
                assert not await later.adopt(Handle("talker", handle.pid, (handle.started or 0.0) + 1.0, handle.log))
                assert not await later.adopt(Handle("another", handle.pid, handle.started, handle.log))
                assert await later.adopt(handle)
                state = await ComponentClient(later.transport, later.clock, r.token).observe("talker")
                assert state.ports["out"]["/chatter"].gate == "open"
                r.kill("talker")
                await until(lambda: exits)
                assert (exits[0].instance, exits[0].status) == ("talker", None)
                assert not await later.adopt(handle)
            finally:
                await later.close()

    run(scenario())


def test_what_an_earlier_manager_started_leaves_the_graph_once_it_is_known_to_be_dead(tmp_path: Path) -> None:
    """An orphan that had to be killed: its lease has not run out, but its name is free."""

    async def scenario() -> None:
        async with rig(tmp_path) as earlier, rig(tmp_path) as later:
            await earlier.start("talker", TALKER)
            await until_async(lambda: later.shows_node("/talker"))
            earlier.kill("talker")
            await until(lambda: earlier.exits)
            assert await later.shows_node("/talker")
            await later.backend.end("talker", KILL_AT_ONCE)
            assert not await later.shows_node("/talker")
            await later.start("talker", TALKER)
            await until_async(lambda: later.shows_node("/talker"))

    run(scenario())


@pytest.mark.full
@pytest.mark.parametrize("named_by", ["option", "environment"])
def test_a_component_started_by_hand_is_found_in_the_system_that_it_names(tmp_path: Path, named_by: str) -> None:
    async def scenario() -> None:
        from midstride.backends.ros2 import create_backend

        system = f"by-hand-{os.getpid()}"
        folder = workspace_folder(system) / COMPONENTS
        backend = create_backend(folder)
        await backend.open(lambda _: None)
        r = Rig(backend, tmp_path, "of-its-manager")
        try:
            assert not await backend.adopt(Handle("talker"))
            r.write("talker", TALKER)
            arguments, environment = ["talker.py"], without_midstride()
            if named_by == "option":
                arguments += ["--system", system]
            else:
                environment[ENV_SYSTEM] = system
            with subprocess.Popen([sys.executable, *arguments], cwd=tmp_path, env=environment) as process:
                try:
                    greeting, _ = await r.welcome("talker")
                    assert (greeting.pid, greeting.start_token) == (process.pid, "")
                    assert await backend.adopt(Handle("talker"))
                    assert (await r.client.observe("talker")).pid == process.pid
                finally:
                    process.terminate()
                    assert await asyncio.to_thread(process.wait, 10) == 0
            assert not await backend.adopt(Handle("talker"))
        finally:
            r.client.close()
            await backend.close()
            shutil.rmtree(folder.parent)

    run(scenario())


def test_a_component_that_belongs_to_no_system_says_how_to_name_one(tmp_path: Path) -> None:
    async def scenario() -> None:
        (tmp_path / "talker.py").write_text(TALKER)
        with subprocess.Popen(
            [sys.executable, "talker.py"], cwd=tmp_path, env=without_midstride(), stderr=subprocess.PIPE, text=True
        ) as process:
            assert process.stderr is not None
            line = await asyncio.to_thread(process.stderr.readline)
            process.terminate()
            assert await asyncio.to_thread(process.wait, 10) == 0
        assert "waits for a manager" in line
        assert "--system NAME" in line and ENV_SYSTEM in line

    run(scenario())


@pytest.mark.full
def test_namespaces(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            greeting, _ = await r.start("front/talker", TALKER, namespace="front")
            assert greeting.instance == "front/talker"
            await r.attach("front/talker", "out", "/chatter")
            await r.start("listener", LISTENER)
            await r.client.change("front/talker", MeetCommand(peer="listener", address=r.client.address("listener")))
            await until_async(lambda: r.shows_node("/front/talker"))
            await until_async(lambda: r.shows_writer("/front/talker", "/chatter"))
            seen = await r.backend.endpoints()
            assert seen.publishers == (("/front/talker", "/chatter"),)

    run(scenario())


@pytest.mark.fast_dds
def test_components_use_sockets_alone(tmp_path: Path) -> None:
    """Shared memory loses first messages and leaves files behind when a process is killed (dds_profiles.py)."""

    async def scenario() -> None:
        async with rig(tmp_path) as r:
            assert r.backend.settings.middleware == "rmw_fastrtps_cpp"
            assert r.backend.warnings == []
            await r.start("talker", TALKER)
            assert shared_memory_of(r.pid("talker")) == []
            assert shared_memory_of(os.getpid()) == []

    run(scenario())


MANAGER = """
import asyncio, sys
from pathlib import Path
from midstride.backends.ros2 import create_backend
from midstride.runtime.backend_protocol import Launch
from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.process.reaper import Reaper
from midstride.wire.environment import ENV_TOKEN

async def main(token):
    backend = create_backend(Path("components"), logs=Path("logs"), guardian=Reaper(ENV_TOKEN, token))
    await backend.open(lambda event: None)
    handle = await backend.start(Launch("talker", "", ("python3", "talker.py"), token, Path.cwd()))
    await ComponentClient(backend.transport, backend.clock, token).registered("talker")
    print(handle.pid, flush=True)
    await asyncio.sleep(600)

asyncio.run(main(sys.argv[1]))
"""


def test_a_killed_manager_with_a_guardian_leaves_no_component(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            r.write("talker", TALKER)
            r.write("manager", MANAGER)
            with subprocess.Popen(
                [sys.executable, "manager.py", r.token], cwd=tmp_path, stdout=subprocess.PIPE, text=True
            ) as manager:
                assert manager.stdout is not None
                pid = int(await asyncio.to_thread(manager.stdout.readline))
                assert alive(pid)
                manager.kill()
            await until(lambda: not alive(pid))

    run(scenario())
