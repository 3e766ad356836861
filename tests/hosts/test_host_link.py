"""The link to a host process and that process, both in this one, over a Unix socket: no SSH, no ROS."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator, Callable, Collection, Container, Coroutine
from contextlib import AbstractAsyncContextManager, asynccontextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from immutables import Map

from midstride.cli import shutdown
from midstride.errors import BackendError, CallTimeout, EndUnknown, StartFailed, Unreachable
from midstride.model.component import DEFAULT_STOP, ParameterSection, StopTimes
from midstride.model.hosts import HostSpec
from midstride.runtime.backend_protocol import (
    Backend,
    DescribedProcess,
    Endpoints,
    Exited,
    Handle,
    Launch,
    RemainingProcess,
)
from midstride.runtime.hosts import call_forms as calls
from midstride.runtime.hosts import host_frames as frames
from midstride.runtime.hosts import host_link, hosts_backend
from midstride.runtime.hosts.host_link import HostLink
from midstride.runtime.hosts.host_order import HostOrder, HostReport
from midstride.runtime.hosts.host_service import HostService
from midstride.runtime.hosts.hosts_backend import HostsBackend, remove_socket_folder, socket_folder
from midstride.runtime.hosts.ssh_connection import HostFault, SshConnection
from midstride.runtime.manager_clock import SystemClock
from midstride.runtime.records.status_forms import Middleware
from midstride.runtime.workspace import Workspace
from midstride.wire.sockets import SocketFolder
from midstride.wire.transport import Connection

ARM = HostSpec("arm", "robot@arm")
ORDER = HostOrder(protocol=frames.HOST_PROTOCOL, system="home", host="arm")


class Platform(Backend):
    """A back end whose components are names, and sockets of this process where they listen."""

    name = "ros2"
    shares_processes = False

    def __init__(self, folder: Path) -> None:
        self.clock, self.transport = SystemClock(), SocketFolder(folder / "components")
        self.running: set[str] = set()
        self.launches: list[Launch] = []
        self.refused: dict[str, BackendError] = {}
        self.stopped: set[str] = set()
        self.forgotten: list[str] = []

    async def open(self, on_exit: Callable[[Exited], None]) -> None:
        self.exit = on_exit

    async def close(self) -> None:
        pass

    def describe(self, launch: Launch) -> DescribedProcess:
        return DescribedProcess(launch.arguments)

    async def start(self, launch: Launch) -> Handle:
        if (error := self.refused.get(launch.instance)) is not None:
            raise error
        self.launches.append(launch)
        self.running.add(launch.instance)
        return Handle(launch.instance, 7, 1.5, f"/logs/{launch.instance}.log")

    async def adopt(self, handle: Handle) -> bool:
        return handle.instance in self.running

    async def end(self, instance: str, stop: StopTimes) -> list[RemainingProcess]:
        if (error := self.refused.get(instance)) is not None:
            raise error
        self.running.discard(instance)
        return [RemainingProcess(7, "sleep", stop.longest)]

    async def end_orphans(self, token: str, known: Container[str], stop: StopTimes) -> list[str]:
        orphans = sorted(name for name in self.running if name not in known)
        self.running.difference_update(orphans)
        return orphans

    def middleware(self) -> Middleware:
        return Middleware(name="none")

    async def endpoints(self, topics: Collection[str] | None = None) -> Endpoints:
        return Endpoints()

    def probe(self) -> AbstractAsyncContextManager[str | None]:
        return nullcontext()

    def disconnected(self, instance: str) -> None:
        self.forgotten.append(instance)

    def is_stopped(self, instance: str) -> bool:
        return instance in self.stopped


@dataclass
class Road:
    """How the host process with the socket ``path`` is connected to. ``down``: why it cannot be now."""

    path: Path
    down: str | None = None

    def __call__(self, host: HostSpec, folder: Path) -> SshConnection:
        return Near(host, folder, self)


class Near(SshConnection):
    """A connection to a host process on this machine."""

    def __init__(self, host: HostSpec, folder: Path, road: Road) -> None:
        super().__init__(host, folder)
        self.road, self.local = road, road.path

    async def open(self, order: HostOrder, environment: Any = None) -> HostReport:
        if self.road.down is not None:
            raise HostFault(self.road.down)
        return HostReport(midstride_host=frames.HOST_PROTOCOL, socket=str(self.local), components="/far/components")

    async def ended(self) -> str:
        await asyncio.Event().wait()
        return ""

    async def close(self) -> None:
        pass


class Far:
    """The host `arm`: its back end, and the host process while it :meth:`runs`."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.platform = folder, Platform(folder)
        self.programs = self.logs = folder
        self.near = Road(folder / "host.sock")
        self.task: asyncio.Task[None] | None = None

    async def run(self, order: HostOrder = ORDER, idle: float = 60.0) -> None:
        """Start the host process; it is another one each time."""
        folders = {"directory": self.programs, "logs": self.logs}
        service = HostService(self.platform, order, **folders, version="1.2.3", idle=idle)
        self.task = asyncio.ensure_future(service.serve(self.folder / "host.sock"))
        while not (self.folder / "host.sock").exists():
            await asyncio.sleep(0.001)

    async def kill(self) -> None:
        """The host process ends, and its connections with it."""
        assert self.task is not None
        self.task.cancel()
        await asyncio.gather(self.task, return_exceptions=True)
        for task in asyncio.all_tasks():
            if task is not asyncio.current_task() and "_accepted" in repr(task):
                task.cancel()


def run(body: Coroutine[Any, Any, None]) -> None:
    async def bounded() -> None:
        await asyncio.wait_for(body, 20.0)

    asyncio.run(bounded())


async def until(condition: Callable[[], object]) -> None:
    while not condition():
        await asyncio.sleep(0.005)


@pytest.fixture(autouse=True)
def short_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(host_link, "FIRST_PAUSE", 0.02)
    monkeypatch.setattr(host_link, "LONGEST_PAUSE", 0.05)


@asynccontextmanager
async def system(folder: Path, far: Far) -> AsyncIterator[tuple[HostsBackend, list[Exited], list[str]]]:
    """The back end of a system with the host `arm`; the exits and the notes that the manager has had."""
    exits: list[Exited] = []
    notes: list[str] = []
    (folder / "home").mkdir(exist_ok=True)
    backend = HostsBackend(Platform(folder), Workspace(folder / "home"), connect=far.near)
    await backend.open(exits.append)
    try:
        await backend.reach_hosts({"arm": ARM}, "token", notes.append, lambda: False)
        yield backend, exits, notes
    finally:
        await backend.close()
        await far.kill()


def launch(instance: str, **more: Any) -> Launch:
    return Launch(instance, "", ("python3", "x.py"), "token", Path("/nowhere"), host="arm", **more)


def test_a_folder_that_ssh_would_not_take_as_it_is_has_a_link_for_its_sockets(tmp_path: Path) -> None:
    for name in ("of a user", "a%h", "a:b", 90 * "x"):
        workspace = Workspace(tmp_path / name)
        workspace.path.mkdir()
        folder = socket_folder(workspace)
        assert (workspace.path / "hosts").is_symlink() and folder.stat().st_mode & 0o777 == 0o700
        assert name not in str(folder) and socket_folder(workspace) == folder
        remove_socket_folder(workspace)
        assert not folder.exists() and not (workspace.path / "hosts").is_symlink()


def test_a_component_is_started_watched_and_ended_on_its_host(tmp_path: Path) -> None:
    async def body() -> None:
        far = Far(tmp_path)
        await far.run()
        async with system(tmp_path, far) as (backend, exits, _):
            sections = (ParameterSection("/**", Map(use_sim_time=True)),)
            given = {"parameters": {"a": 1.0, "b": [1, 2]}, "environment": {"X": None}, "sections": sections}
            handle = await backend.start(launch("gripper", topics={"out": "/grip"}, **given))
            assert handle == Handle("gripper", 7, 1.5, "/logs/gripper.log", "arm")
            assert handle.log_file == "arm:/logs/gripper.log"
            (arrived,) = far.platform.launches
            assert (arrived.directory, arrived.arguments, arrived.environment) == (
                tmp_path,
                ("python3", "x.py"),
                {"X": None},
            )
            assert arrived.parameters == {"a": 1.0, "b": [1, 2]} and isinstance(arrived.parameters["a"], float)
            assert arrived.sections == sections and arrived.topics == {"out": "/grip"}
            far.platform.stopped.add("gripper")
            await until(lambda: backend.is_stopped("gripper"))
            assert await backend.adopt(handle)
            assert await backend.end("gripper", DEFAULT_STOP) == [RemainingProcess(7, "sleep", 10.0)]
            await backend.start(launch("gripper_2"))
            far.platform.exit(Exited("gripper_2", -9, "its last words"))
            await until(lambda: exits)
            assert exits == [Exited("gripper_2", -9, "its last words")]
            assert not await backend.adopt(Handle("gone", 7, 1.5, None, "arm"))

    run(body())


@pytest.mark.parametrize("lost", ["programs", "logs"])
def test_a_folder_that_is_removed_there_while_the_system_runs_is_said(tmp_path: Path, lost: str) -> None:
    async def body() -> None:
        far = Far(tmp_path)
        far.programs, far.logs = tmp_path / "programs", tmp_path / "logs"
        far.programs.mkdir()
        far.logs.mkdir()
        await far.run()
        async with system(tmp_path, far) as (backend, _, _):
            await backend.start(launch("gripper"))
            assert backend.unwritten() is None
            (tmp_path / lost).rmdir()
            await until(backend.unwritten)
            words = f"the folder {tmp_path / lost} is not there any more, or cannot be read, so changes fail: "
            assert (backend.unwritten() or "").startswith(words)
            with pytest.raises(StartFailed, match=f"gripper_2: {words}.*`midstride down` and `midstride up`"):
                await backend.start(launch("gripper_2"))

    run(body())


def test_what_its_back_end_raises_is_raised_here_with_the_name_of_the_host(tmp_path: Path) -> None:
    async def body() -> None:
        far = Far(tmp_path)
        await far.run()
        async with system(tmp_path, far) as (backend, _, _):
            far.platform.refused["x"] = StartFailed("x: there is no program")
            with pytest.raises(StartFailed, match=r"x: there is no program \(on host arm\)"):
                await backend.start(launch("x"))
            await backend.start(launch("y"))
            far.platform.refused["y"] = EndUnknown("y: it is not known")
            with pytest.raises(EndUnknown, match="not known"):
                await backend.end("y", DEFAULT_STOP)

    run(body())


def test_a_process_that_does_not_die_is_no_reason_to_give_its_host_up(tmp_path: Path) -> None:
    async def body() -> None:
        far = Far(tmp_path)
        await far.run()
        async with system(tmp_path, far) as (backend, _, notes):
            await backend.start(launch("y"))
            far.platform.refused["x"] = BackendError("x was killed, but [7] did not exit")
            backend._links["arm"].lost("x")
            await until(lambda: notes)
            assert notes == ["x could not be ended on host arm: x was killed, but [7] did not exit (on host arm)"]
            await far.kill()
            await far.run()
            await until(lambda: len(notes) > 2 and not backend.problems())
            assert any("host arm is reached again" in each for each in notes)
            assert backend._links["arm"].is_used

    run(body())


def test_a_host_that_is_needed_no_more_is_left_once_nothing_runs_there(tmp_path: Path) -> None:
    async def body() -> None:
        far = Far(tmp_path)
        await far.run()
        async with system(tmp_path, far) as (backend, exits, _):
            await backend.start(launch("x"))
            await backend.leave_hosts(())
            assert [each.host for each in backend.host_links()] == ["arm"], "x runs there"
            await backend.end("x", DEFAULT_STOP)
            await backend.leave_hosts({"arm"})
            assert [each.host for each in backend.host_links()] == ["arm"]
            await backend.leave_hosts(())
            assert backend.host_links() == [] and backend.problems() == {} and exits == []

    run(body())


def test_a_host_that_cannot_be_reached_says_why_in_all_that_is_asked_of_it(tmp_path: Path) -> None:
    async def body() -> None:
        far = Far(tmp_path)
        far.near.down = "its name is not known"
        await far.run()
        async with system(tmp_path, far) as (backend, exits, _):
            assert backend.problems() == {"arm": "its name is not known"}
            with pytest.raises(StartFailed, match="x: host arm cannot be reached: its name is not known"):
                await backend.start(launch("x"))
            with pytest.raises(Unreachable, match="its name is not known"):
                await backend.adopt(Handle("x", 7, 1.5, None, "arm"))
            with pytest.raises(EndUnknown, match="whether x runs there is not known"):
                await backend.end("x", DEFAULT_STOP)  # as `down` does
            with pytest.raises(Unreachable, match="host leg is not declared"):
                await backend.adopt(Handle("y", 7, 1.5, None, "leg"))
            with pytest.raises(EndUnknown, match="whether y runs there is not known"):
                await backend.end("y", DEFAULT_STOP)
            far.near.down = None
            await until(lambda: not backend.problems())
            assert (await backend.start(launch("x"))).host == "arm" and exits == []

    run(body())


def test_a_host_is_tried_again_at_once_and_not_for_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(host_link, "FIRST_PAUSE", 1000.0)
    monkeypatch.setattr(host_link, "LONGEST_PAUSE", 1000.0)

    async def body() -> None:
        far = Far(tmp_path)
        far.near.down = "its name is not known"
        await far.run()
        async with system(tmp_path, far) as (backend, _, notes):
            far.near.down = "permission denied"
            await backend.try_again(["leg"])
            assert backend.problems() == {"arm": "its name is not known"}
            await asyncio.gather(backend.try_again(["arm"]), backend.try_again(["arm"]))
            assert backend.problems() == {"arm": "permission denied"}
            open_one, asked = Near.open, asyncio.Event()

            async def hang(*_: Any) -> HostReport:
                asked.set()
                await asyncio.Event().wait()
                raise AssertionError

            with monkeypatch.context() as patch:
                patch.setattr(host_link, "AGAIN_SECONDS", 0.05)
                patch.setattr(Near, "open", hang)
                await backend.try_again(["arm"])
                assert asked.is_set() and backend.problems() == {"arm": "permission denied"}
            assert Near.open is open_one
        far.near.down = None
        await far.run()
        async with system(tmp_path, far) as (backend, _, notes):
            far.near.down = "it is cut"
            _cut(backend)
            await until(backend.problems)
            far.near.down = None
            await backend.try_again(["arm"])  # also while the connection before is being closed
            assert not backend.problems() and "is reached again" in notes[-1]
            await backend.try_again(["arm"])
            assert (await backend.start(launch("x"))).host == "arm"

    run(body())


def test_a_file_that_a_program_names_is_looked_for_on_the_host(tmp_path: Path) -> None:
    async def body() -> None:
        far = Far(tmp_path)
        await far.run()
        link = HostLink(ARM, ORDER, tmp_path, lambda: "", lambda _: None, reads=True, connect=far.near)
        await link.open()
        described = calls.Describe(launch=calls.LaunchForm.of(launch("x")))
        with pytest.raises(StartFailed, match=rf"there is no file {tmp_path}/x.py for `python3 x.py`: copy it"):
            await link.call(described, list[str])
        (tmp_path / "x.py").touch()
        assert await link.call(described, list[str]) == ["python3", "x.py"]
        await link.close()
        await far.kill()

    run(body())


def test_exits_while_the_link_was_down_come_once_it_is_back(tmp_path: Path) -> None:
    async def body() -> None:
        far = Far(tmp_path)
        await far.run()
        async with system(tmp_path, far) as (backend, exits, notes):
            for name in ("a", "b", "c"):
                await backend.start(launch(name))
            far.platform.exit(Exited("a", 1))
            await until(lambda: exits)
            far.near.down = "it cannot be reached over the network"
            _cut(backend)
            await until(lambda: notes)
            assert "host arm cannot be reached" in notes[0]
            with pytest.raises(EndUnknown, match="whether c runs there is not known"):
                await backend.end("c", DEFAULT_STOP)
            far.platform.exit(Exited("b", 2))
            far.near.down = None
            await until(lambda: len(exits) == 2 and not backend.problems())
            assert [each.instance for each in exits] == ["a", "b"]
            assert "is reached again" in notes[-1]
            await backend.end("c", DEFAULT_STOP)

    run(body())


def test_what_may_have_been_started_as_the_link_broke_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def body() -> None:
        far = Far(tmp_path)
        await far.run()
        async with system(tmp_path, far) as (backend, exits, _):
            begin = far.platform.start

            async def start(launch: Launch) -> Handle:
                handle = await begin(launch)
                far.near.down = "it is cut"
                _cut(backend)
                await asyncio.sleep(0.02)
                return handle

            monkeypatch.setattr(far.platform, "start", start)
            with pytest.raises(StartFailed, match="the connection to host arm ended meanwhile"):
                await backend.start(launch("a"))
            assert far.platform.running == {"a"}
            far.near.down = None
            await until(lambda: not backend.problems() and not far.platform.running)
            assert exits == []

    run(body())


@pytest.mark.parametrize("ends", ["link", "patience", "change"])
def test_a_start_that_nobody_waits_for_any_more_is_ended_once_it_is_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ends: str
) -> None:
    """As of a node that a container takes long to load."""

    async def body() -> None:
        far = Far(tmp_path)
        await far.run()
        async with system(tmp_path, far) as (backend, exits, _):
            begin, begun, loaded = far.platform.start, asyncio.Event(), asyncio.Event()
            carry_out, asked = HostService._call, asyncio.Event()

            async def called(service: HostService, call: calls.HostCall) -> Any:
                if isinstance(call, calls.End):
                    asked.set()
                return await carry_out(service, call)

            monkeypatch.setattr(HostService, "_call", called)

            async def start(launch: Launch) -> Handle:
                begun.set()
                await loaded.wait()
                return await begin(launch)

            monkeypatch.setattr(far.platform, "start", start)
            if ends == "patience":
                monkeypatch.setattr(hosts_backend, "START_SECONDS", 0.05)
            starting = asyncio.ensure_future(backend.start(launch("a")))
            await begun.wait()
            if ends == "link":
                _cut(backend)
            elif ends == "change":
                starting.cancel()
            with pytest.raises(asyncio.CancelledError if ends == "change" else StartFailed):
                await starting
            await asked.wait()
            loaded.set()
            await until(lambda: far.platform.launches)
            await until(lambda: not far.platform.running and not backend.problems())
            assert exits == []

    run(body())


def test_what_was_ended_as_the_link_broke_has_exited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def body() -> None:
        far = Far(tmp_path)
        await far.run()
        async with system(tmp_path, far) as (backend, exits, _):
            end = far.platform.end

            async def ended(instance: str, stop: StopTimes) -> list[RemainingProcess]:
                far.near.down = "it is cut"
                _cut(backend)
                await asyncio.sleep(0.02)
                return await end(instance, stop)

            await backend.start(launch("a"))
            await backend.start(launch("b"))
            monkeypatch.setattr(far.platform, "end", ended)
            with pytest.raises(EndUnknown, match="whether a runs there is not known"):
                await backend.end("a", DEFAULT_STOP)
            far.near.down = None
            await until(lambda: exits)
            assert [each.instance for each in exits] == ["a"] and "as it was asked to" in exits[0].words

    run(body())


def test_a_link_that_breaks_while_what_runs_is_compared_is_compared_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At once, and with the same host process: what the one before has started is ended all the same."""

    async def body() -> None:
        far = Far(tmp_path)
        await far.run()
        async with system(tmp_path, far) as (backend, exits, notes):
            await backend.start(launch("a"))
            await far.kill()
            _cut(backend)
            far.platform.running.add("started")
            adopt, asked = far.platform.adopt, list[str]()

            async def adopted(handle: Handle) -> bool:
                asked.append(handle.instance)
                if len(asked) == 1:
                    _cut(backend)
                    await asyncio.sleep(0.02)
                return await adopt(handle)

            monkeypatch.setattr(far.platform, "adopt", adopted)
            await far.run()
            await until(lambda: not backend.problems())
            assert far.platform.running == {"a"} and exits == []
            assert "started, which was being started on host arm, was ended there" in notes

    run(body())


def test_a_link_that_has_just_broken_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def body() -> None:
        far = Far(tmp_path)
        await far.run()
        left = asyncio.Event()

        async def close(_: Near) -> None:
            await left.wait()

        async with system(tmp_path, far) as (backend, _, _):
            await backend.start(launch("a"))
            monkeypatch.setattr(Near, "close", close)
            before = time.time()
            _cut(backend)
            await until(lambda: backend._links["arm"]._ssh is None)
            assert backend.problems() == {"arm": "the connection was closed"}
            (link,) = backend.host_links()
            assert link.problem == "the connection was closed" and link.since >= before
            with pytest.raises(CallTimeout, match="host arm cannot be reached: the connection was closed"):
                await backend.transport.connect(backend.transport.address("a"))
            left.set()

    run(body())


def _cut(backend: HostsBackend) -> None:
    """End the connection to the host, as a link does that is cut."""
    if (writer := backend._links["arm"]._writer) is not None:
        writer.transport.abort()


def test_another_host_process_finds_the_components_that_run_and_names_those_that_do_not(tmp_path: Path) -> None:
    async def body() -> None:
        far = Far(tmp_path)
        await far.run()
        async with system(tmp_path, far) as (backend, exits, _):
            await backend.start(launch("a"))
            await backend.start(launch("b"))
            await far.kill()
            _cut(backend)
            far.platform.running.discard("b")
            await far.run()
            await until(lambda: exits and not backend.problems())
            (gone,) = exits
            assert gone.instance == "b" and "while `midstride host` did not run on arm" in gone.words
            await backend.end("a", DEFAULT_STOP)

    run(body())


def test_another_host_process_ends_what_the_one_before_has_started_and_could_tell_nobody_of(tmp_path: Path) -> None:
    async def body() -> None:
        far = Far(tmp_path)
        await far.run()
        async with system(tmp_path, far) as (backend, exits, notes):
            await backend.start(launch("a"))
            await backend.start(replace(launch("here"), host=""))  # which the host may see, as one computer can be two
            await far.kill()
            _cut(backend)
            far.platform.running |= {"started", "here"}
            await far.run()
            await until(lambda: "started" not in far.platform.running and not backend.problems())
            assert far.platform.running == {"a", "here"} and exits == []
            await backend.end("here", DEFAULT_STOP)
            assert "here" not in [*backend._links["arm"]._known()], "what has ended is not kept for ever"
            assert "started, which was being started on host arm, was ended there" in notes

    run(body())


def test_down_without_a_manager_ends_what_that_was_starting_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def nothing(*_: Any) -> list[str]:
        return []

    async def body() -> None:
        far = Far(tmp_path)
        await far.run()
        far.platform.running |= {"a", "started"}
        (tmp_path / "home").mkdir()
        backend = HostsBackend(Platform(tmp_path / "home"), Workspace(tmp_path / "home"), connect=far.near)
        entry = SimpleNamespace(handle=Handle("a", 7, 1.5, None, "arm"), instance=SimpleNamespace(started=None))
        saved: Any = SimpleNamespace(
            instances=[entry], specification=SimpleNamespace(hosts={"arm": ARM}), token="token"
        )
        monkeypatch.setattr(shutdown, "end_orphans", nothing)  # of this host
        monkeypatch.setattr(shutdown, "stop_times", lambda component: DEFAULT_STOP)
        far.near.down = "it is cut"
        lost = HostsBackend(Platform(tmp_path / "home"), Workspace(tmp_path / "home"), connect=far.near)
        _, failures = await shutdown._stop(lost, saved)
        assert len(failures) == 1 and failures[0].endswith("once host arm is reached again, run `midstride down` again")
        far.near.down = None
        _, failures = await shutdown._stop(backend, saved)
        assert failures == [] and far.platform.running == set()
        await far.kill()

    run(body())


def test_the_next_manager_has_no_exits_of_the_one_before_and_another_system_is_refused(tmp_path: Path) -> None:
    async def body() -> None:
        far = Far(tmp_path)
        await far.run()
        first: list[Exited] = []
        one = HostLink(ARM, ORDER, tmp_path, lambda: "token", first.append, connect=far.near)
        await one.open()
        await one.call(calls.Start(launch=calls.LaunchForm.of(launch("a"))), calls.HandleForm)
        await one.call(calls.Start(launch=calls.LaunchForm.of(launch("b"))), calls.HandleForm)
        far.platform.exit(Exited("b", 1))
        await until(lambda: first)
        await one.close()
        exits: list[Exited] = []
        notes: list[str] = []
        two = HostLink(ARM, ORDER, tmp_path, lambda: "token", exits.append, notes.append, connect=far.near)
        await two.open()
        assert two.problem is None and exits == []
        assert two._writer is not None
        two._writer.transport.abort()
        await until(lambda: len(notes) == 2)  # the link was lost, and is back
        assert exits == []
        await two.call(calls.Start(launch=calls.LaunchForm.of(launch("c"))), calls.HandleForm)
        far.platform.exit(Exited("c", 1))
        await until(lambda: exits)
        assert [each.instance for each in exits] == ["c"]
        await two.close()
        other = HostLink(ARM, ORDER, tmp_path, lambda: "another", exits.append, connect=far.near)
        await other.open()
        assert other.problem is not None and "another start of home" in other.problem
        await other.close()
        meant = HostOrder(protocol=frames.HOST_PROTOCOL, system="house", host="arm")
        wrong = HostLink(ARM, meant, tmp_path, lambda: "token", exits.append, connect=far.near)
        await wrong.open()
        assert wrong.problem is not None and "its folder has the host process of home" in wrong.problem
        await wrong.close()
        await far.kill()

    run(body())


def test_a_manager_that_another_one_has_superseded_does_not_take_its_link(tmp_path: Path) -> None:
    async def body() -> None:
        far = Far(tmp_path)
        await far.run()
        superseded: list[bool] = []
        token, exited = (lambda: "token"), (lambda _: None)
        one = HostLink(ARM, ORDER, tmp_path, token, exited, superseded=lambda: bool(superseded), connect=far.near)
        two = HostLink(ARM, ORDER, tmp_path, token, exited, connect=far.near)
        await one.open()
        superseded.append(True)
        await two.open()  # which ends the connection of the first
        await until(lambda: one.problem == "another manager of this system has taken over")
        assert not one.connected
        assert two.connected
        await one.close()
        await two.close()
        await far.kill()

    run(body())


def test_the_control_connection_of_a_component_goes_through_the_host_process(tmp_path: Path) -> None:
    async def body() -> None:
        far = Far(tmp_path)
        await far.run()

        async def echo(connection: Connection) -> None:
            await connection.send(b'{"hello": 1}')
            while (line := await connection.receive()) is not None:
                await connection.send(line)

        async with system(tmp_path, far) as (backend, _, _):
            with pytest.raises(Unreachable):
                await backend.transport.connect(backend.transport.address("a"))
            await backend.start(launch("a"))
            address = backend.transport.address("a")
            assert address == "unix:/far/components/a.sock"  # as its peers on the host have it
            with pytest.raises(Unreachable, match=r"on host arm"):
                await backend.transport.connect(address)
            stop = await far.platform.transport.listen("a", echo)
            connection = await backend.transport.connect(address)
            assert await connection.receive() == b'{"hello": 1}'
            await connection.send(b"x" * 200_000)
            assert await connection.receive() == b"x" * 200_000
            assert connection.peer == -1  # the end of the connection is not that of the component
            far.near.down = "it is cut"
            _cut(backend)
            await until(lambda: backend.problems() == {"arm": "it is cut"})
            with pytest.raises(CallTimeout, match="it is cut"):
                await backend.transport.connect(address)
            connection.close()
            stop()

    run(body())


def test_a_host_process_ends_once_nothing_is_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("midstride.runtime.hosts.host_service.LOOK", 0.01)

    async def body() -> None:
        far = Far(tmp_path)
        await far.run(idle=0.3)
        async with system(tmp_path, far) as (backend, _, _):
            await backend.start(launch("a"))
            far.near.down = "cut"
            _cut(backend)
            await asyncio.sleep(0.5)
            assert far.task is not None and not far.task.done()  # it watches a component
            far.near.down = None
            await until(lambda: not backend.problems())
            await backend.end("a", DEFAULT_STOP)
            await asyncio.sleep(0.5)
            assert not far.task.done()  # a manager is connected
        await asyncio.wait_for(asyncio.gather(far.task, return_exceptions=True), 5.0)
        assert not (tmp_path / "host.sock").exists()

    run(body())


@pytest.mark.parametrize(
    "said",
    [
        b"not json\n",
        b'{"protocol": 99}\n',
        b'{"frame": "accepted"}\n',
        b'{"frame": "host", "protocol": 1, "version": "1", "control": 99, "system": "home", "host": "arm", '
        b'"uuid": "u", "pid": 1}\n',
        b"",
    ],
)
def test_a_host_process_that_says_something_else_is_not_used(tmp_path: Path, said: bytes) -> None:
    async def body() -> None:
        async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            writer.write(said)
            await writer.drain()
            writer.close()

        server = await asyncio.start_unix_server(answer, tmp_path / "host.sock")
        link = HostLink(ARM, ORDER, tmp_path, lambda: "token", lambda _: None, connect=Far(tmp_path).near)
        await link.open()
        assert link.problem is not None and not link.connected
        await link.close()
        server.close()

    run(body())


@pytest.mark.parametrize(
    "line",
    [
        b"\xff\n",
        b"{}\n",
        json.dumps({"frame": "manager", "protocol": 1}).encode() + b"\n",
        json.dumps({"frame": "reader", "protocol": 1}).encode()
        + b"\n"
        + json.dumps({"frame": "call", "number": 1, "call": {"name": "keep_spares", "count": 9, "token": "t"}}).encode()
        + b"\n",
        json.dumps({"frame": "component", "protocol": 1, "instance": "../../x"}).encode() + b"\n",
    ],
)
def test_a_client_that_says_something_else_changes_nothing(tmp_path: Path, line: bytes) -> None:
    async def body() -> None:
        far = Far(tmp_path)
        await far.run()
        reader, writer = await asyncio.open_unix_connection(tmp_path / "host.sock")
        frames.decode_greeting((await reader.readline())[:-1])
        writer.write(line)
        rest = await reader.read()
        assert b'"result"' not in rest
        writer.close()
        assert far.platform.launches == []
        await far.kill()

    run(body())


def test_a_reader_reads_logs_and_nothing_else_of_the_disk(tmp_path: Path) -> None:
    async def body() -> None:
        far = Far(tmp_path)
        await far.run()
        (tmp_path / "a.log").write_bytes(b"0123456789\xff")
        (tmp_path / "secret.log").symlink_to("/etc/hostname")
        link = HostLink(ARM, ORDER, tmp_path, lambda: "", lambda _: None, reads=True, connect=far.near)
        await link.open()
        read = calls.ReadLog(file="a.log", begin=4, longest=100)
        assert (await link.call(read, calls.LogPiece)).content == b"456789\xff"
        for name in ("../a.log", "/etc/hostname", "secret.log"):
            with pytest.raises(BackendError, match="is no log"):
                await link.call(calls.ReadLog(file=name, begin=0, longest=10), calls.LogPiece)
        await link.close()
        await far.kill()

    run(body())


def test_a_socket_of_a_host_process_is_for_its_user_alone(tmp_path: Path) -> None:
    async def body() -> None:
        far = Far(tmp_path)
        await far.run()
        assert (tmp_path / "host.sock").stat().st_mode & 0o777 == 0o600
        await far.kill()

    run(body())
