"""The manager's side on real ROS 1: processes, the master, and what a killed node leaves."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from midstride.backends.ros1 import master_process
from midstride.backends.ros1.master import Master
from midstride.errors import CallTimeout, StartFailed, Unreachable
from midstride.model.component import StopTimes
from midstride.runtime.backend_protocol import Handle
from midstride.runtime.process.child_process import Process, spawn
from midstride.runtime.process.reaper import environment_value
from midstride.wire.channel import Channel
from midstride.wire.commands import AwaitWriteCommand, PingCommand
from midstride.wire.environment import ENV_SYSTEM
from midstride.wire.folders import workspace_folder
from tests.backends.ros1_support import free_port, own_master_uri, program, rig, wait_for
from tests.backends.ros2_support import LISTENER, TALKER, Rig, alive, run, until, until_async

pytestmark = pytest.mark.ros1

# A component whose ports are always the same: the next one with these ports is easily taken for it.
FIXED_PORTS = """
import functools, sys, rospy
rospy.init_node = functools.partial(rospy.init_node, xmlrpc_port=int(sys.argv[1]), tcpros_port=int(sys.argv[2]))
"""


def test_a_component_is_started_attached_heard_and_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            greeting, registration = await r.start("talker", TALKER)
            assert greeting.pid == r.pid("talker")
            assert registration.endpoints == []
            await r.start("listener", LISTENER)
            await r.attach("talker", "out", "/chatter")
            await r.attach("listener", "in", "/chatter", peers=1)
            await r.modes("talker", talk="normal")
            await r.modes("listener", listen="normal")
            seen = await r.backend.endpoints()
            assert seen.nodes == {"/talker", "/listener"}
            assert seen.publishers == (("/talker", "/chatter"),)
            assert seen.subscribers == (("/listener", "/chatter"),)
            await r.modes("talker", talk="degraded")
            assert (await r.detach("talker", "out", "/chatter")).acknowledged is True
            pid = r.pid("talker")
            await r.backend.end("talker", StopTimes(0.0, 5.0))
            assert not alive(pid)
            assert r.exits == []  # a requested end is not reported
            assert await clean(r, "/talker")
            where = f"TCPROS at the master {r.backend._master.uri}"
            monkeypatch.delenv("ROS_DISTRO", raising=False)
            assert r.backend.middleware().where == where, "which distribution it is, nothing tells"
            monkeypatch.setenv("ROS_DISTRO", "noetic")
            assert r.backend.middleware().where == f"{where} on ROS 1 noetic"

    run(scenario())


async def clean(r: Rig, node: str) -> bool:
    """Whether the master lists a node nowhere."""
    master = r.backend._master
    return node not in (await master.state()).nodes() and await master.address_of(node) is None


def test_a_killed_component_is_known_at_once_and_the_master_has_forgotten_it_by_then(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", TALKER)
            await r.attach("talker", "out", "/chatter")
            waiting = AwaitWriteCommand(port="out", topic="/chatter", timeout=30.0)
            calling = asyncio.ensure_future(r.client.read("talker", waiting))
            await asyncio.sleep(0.1)
            r.kill("talker")
            await until(lambda: r.exits)
            assert (r.exits[0].instance, r.exits[0].status) == ("talker", -signal.SIGKILL)
            assert await clean(r, "/talker")
            with pytest.raises(Unreachable, match="talker"):
                await asyncio.wait_for(calling, 1.0)
            with pytest.raises(Unreachable):
                await r.client.read("talker", PingCommand())
            assert await r.backend.lingering_readers("/chatter") == 0

    run(scenario())


async def subscribed(master: Master, topic: str) -> bool:
    return topic in (await master.state()).subscribers


async def kill_again_and_again(r: Rig, folder: Path, times: int) -> None:
    """Talkers on the same ports, each killed while it writes, beside nodes that must not freeze."""
    ports = str(free_port()), str(free_port())
    heard = folder / "heard"
    await r.start("listener", LISTENER)
    await r.attach("listener", "in", "/chatter")
    await r.modes("listener", listen="normal")
    with program("bystander", "/chatter", str(heard)):
        for index in range(times):
            name = f"talker_{index}"
            await r.start(name, FIXED_PORTS + TALKER, *ports)
            lines = len(heard.read_text().splitlines()) if heard.exists() else 0
            await r.attach(name, "out", "/chatter", peers=2)
            await r.modes(name, talk="normal")
            await asyncio.to_thread(wait_for, heard, lines + 5, 5.0)  # a freeze lasts 60 s
            state = await asyncio.wait_for(r.client.observe("listener"), 20.0)
            assert state.functionalities["listen"].mode == "normal"
            r.kill(name)
            await until(lambda: r.exits)
            r.exits.clear()
            assert await clean(r, f"/{name}")
            assert (await r.backend._master.state()).nodes() <= {"/listener", "/bystander"}


def test_components_are_killed_and_their_ports_reused(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await kill_again_and_again(r, tmp_path, 4)

    run(scenario())


@pytest.mark.long
@pytest.mark.timeout(900)
def test_components_are_killed_and_their_ports_reused_a_hundred_times(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await kill_again_and_again(r, tmp_path, 100)

    run(scenario(), 850)


def test_what_a_killed_node_has_left_is_taken_back_before_its_name_is_used_again(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            with program("talker", "/chatter", str(tmp_path / "heard")) as bare:
                master = r.backend._master
                while (
                    await master.address_of("/talker") is None or "/chatter" not in (await master.state()).subscribers
                ):
                    await asyncio.sleep(0.02)
                with pytest.raises(StartFailed, match=r"a node /talker is running already, at http://\S+/, and "):
                    await r.launch("talker", TALKER)
                bare.kill()
                bare.wait()
            assert (
                "/talker" in (await master.state()).subscribers["/chatter"]
            )  # for ever, if Midstride did not take it back
            await r.start("talker", TALKER)
            assert "/chatter" not in (await master.state()).subscribers

    run(scenario())


def test_subscriptions_to_parameters_do_not_keep_a_dead_node_known(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            master, nowhere = r.backend._master, f"http://127.0.0.1:{free_port()}/"
            await master.call("subscribeParam", "/ghost", nowhere, "/some/parameter")
            assert await master.address_of("/ghost") == nowhere
            await master.unregister("/ghost")
            assert await master.address_of("/ghost") is None

    run(scenario())


def test_a_component_that_is_paused_is_given_up_and_answers_once_it_is_continued(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", TALKER)
            await r.start("listener", LISTENER)
            transport = r.backend.transport
            channel = await Channel.open(transport, transport.address("talker"), r.token, timeout=2.0)
            r.kill("talker", signal.SIGSTOP)
            paused = time.monotonic()
            with pytest.raises(CallTimeout):
                await channel.request(PingCommand(), timeout=0.5)
            assert time.monotonic() - paused > 0.4
            await r.client.observe("listener")
            await asyncio.sleep(3.0 - (time.monotonic() - paused))
            r.kill("talker", signal.SIGCONT)
            continued = time.monotonic()
            assert (await channel.request(PingCommand(), timeout=1.0)).ok
            assert (await r.client.observe("talker")).pid == r.pid("talker")
            assert time.monotonic() - continued < 1.0
            channel.close()

    run(scenario())


@pytest.mark.parametrize("by", ["option", "environment"])
def test_a_component_started_by_hand_is_found_in_the_system_that_it_names(
    by: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    if by == "environment":
        monkeypatch.setenv(ENV_SYSTEM, "robot")

    async def scenario() -> None:
        async with rig(workspace_folder("robot")) as r:
            handle = Handle("talker")
            assert await r.backend.adopt(handle) is False
            options = ("--system", "robot") if by == "option" else ()
            with program(*options, source=TALKER) as process:
                greeting, _ = await r.welcome("talker")
                assert (greeting.pid, greeting.start_token) == (process.pid, "")
                assert await r.backend.adopt(handle) is True
                await r.attach("talker", "out", "/chatter")
                await r.modes("talker", talk="normal")
                process.kill()
                process.wait()
            assert await r.backend.adopt(handle) is False

    run(scenario())


def test_a_component_of_no_system_says_how_to_name_one(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            log = tmp_path / "log"
            with program(source=TALKER, output=log) as process:
                await until(lambda: "MIDSTRIDE_SYSTEM=NAME" in log.read_text())
                assert "--system NAME" in log.read_text()
                process.send_signal(signal.SIGTERM)
                assert await asyncio.to_thread(process.wait, 10.0) == 0
            assert r.backend.transport.present() == {}

    run(scenario())


# -- the master -------------------------------------------------------------------------------------------------


@pytest.mark.full
def test_a_component_on_another_master_is_not_found_and_it_is_said_why(tmp_path: Path) -> None:
    from midstride.backends.ros1 import create_backend

    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", TALKER)
            with own_master_uri():
                elsewhere = create_backend(tmp_path / "components", logs=tmp_path / "elsewhere")
                await elsewhere.open(lambda exited: None)
                with pytest.raises(Unreachable, match=f"ROS_MASTER_URI={r.backend._master.uri}"):
                    await elsewhere.adopt(r.handles["talker"])
                await elsewhere.end(
                    "talker", StopTimes(0.0, 2.0)
                )  # that needs no master: `midstride down` ends it all the same
                assert not alive(r.pid("talker"))
                await elsewhere.close()
            await until(lambda: r.exits)

    run(scenario())


@contextlib.contextmanager
def foreign_master(uri: str) -> Iterator[subprocess.Popen[bytes]]:
    code = "import sys, rosmaster; rosmaster.rosmaster_main(sys.argv)"
    process = subprocess.Popen([sys.executable, "-c", code, "--core", "-p", uri.rpartition(":")[2]])
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def test_a_master_that_runs_is_used_and_left_alone(tmp_path: Path) -> None:
    from midstride.backends.ros1 import create_backend

    async def scenario(process: subprocess.Popen[bytes], uri: str) -> None:
        while await Master(uri, "/test").process() is None:
            await asyncio.sleep(0.02)
        backend = create_backend(tmp_path / "components", logs=tmp_path)
        await backend.open(lambda exited: None)
        assert not backend.started_master
        assert await backend._master.process() == process.pid
        await backend.close()
        assert process.poll() is None
        assert (await Master(uri, "/test").state()).nodes() == frozenset()

    with own_master_uri() as uri, foreign_master(uri) as process:
        run(scenario(process, uri))


def test_a_master_that_was_started_ends_with_the_last_that_needs_it(tmp_path: Path) -> None:
    """A second manager and a bare node join; the last to leave ends the master that Midstride started."""
    from midstride.backends.ros1 import create_backend

    async def scenario(uri: str) -> None:
        first, second, third = (create_backend(tmp_path / "components", logs=tmp_path) for _ in range(3))
        await first.open(lambda exited: None)
        await second.open(lambda exited: None)
        assert (first.started_master, second.started_master) == (True, False)
        pid = await first._master.process()
        assert pid is not None and environment_value(pid, master_process.ENV_STARTED) == uri.rpartition(":")[2]
        await first.close()
        assert alive(pid), "the second manager needs it"
        with program("guest", "/chatter", str(tmp_path / "heard")):
            await until_async(lambda: subscribed(second._master, "/chatter"))
            await second.close()
            assert alive(pid), "a node that is not Midstride's needs it"
        await third.open(lambda exited: None)
        await third.close()
        assert not alive(pid), "the registrations of a dead node do not count"

    with own_master_uri() as uri:
        run(scenario(uri))


def test_components_outlive_their_manager_and_its_master_does_too(tmp_path: Path) -> None:
    from midstride.backends.ros1 import create_backend

    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", TALKER)
            first, handle = r.backend, r.handles["talker"]
            await first.close()
            assert alive(r.pid("talker"))
            second = create_backend(tmp_path / "components", logs=tmp_path / "logs")
            await second.open(r.exits.append)
            r.backend = second
            assert not second.started_master
            assert await second.adopt(Handle("nobody", 2**22 - 1, 1.0)) is False
            assert await second.adopt(handle) is True
            assert (await r.client.observe("talker")).pid == r.pid("talker")
            r.kill("talker")
            await until(lambda: r.exits)
            assert (r.exits[0].instance, r.exits[0].status) == ("talker", None)  # not its child: the status is unknown
            assert await clean(r, "/talker")
            await second.close()
            assert await first._master.process() is None
            await first.open(r.exits.append)  # the rig closes it
            r.backend = first
            r.handles.clear()

    run(scenario())


def test_a_killed_manager_does_not_keep_the_master(tmp_path: Path) -> None:
    """Only a manager that runs counts: what it leaves behind when it is killed does not."""
    manager = """
import sys, time
from midstride.backends.ros1 import master_process
mark = master_process.hold(sys.argv[1])
print("held", flush=True)
time.sleep(60)
"""
    from midstride.backends.ros1 import create_backend

    async def scenario(uri: str) -> None:
        first, second = (create_backend(tmp_path / "components", logs=tmp_path) for _ in range(2))
        await first.open(lambda exited: None)
        pid = await first._master.process()
        assert pid is not None
        said = tmp_path / "said"
        with program(uri, source=manager, output=said):
            await asyncio.to_thread(wait_for, said, 1)
            await first.close()
            assert alive(pid)
        await second.open(lambda exited: None)
        await second.close()
        assert not alive(pid)

    with own_master_uri() as uri:
        run(scenario(uri))


def test_a_master_that_is_started_for_nothing_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The manager is ended while its master comes up."""
    from midstride.backends.ros1 import create_backend

    started: list[int] = []

    def noted(*arguments: Any) -> Process:
        process = spawn(*arguments)
        started.append(process.pid)
        return process

    async def scenario() -> None:
        opening = asyncio.ensure_future(
            create_backend(tmp_path / "components", logs=tmp_path).open(lambda exited: None)
        )
        await until_async(lambda: asyncio.sleep(0, bool(started)))
        opening.cancel()
        await asyncio.wait({opening})
        assert opening.cancelled() and not alive(started[0])

    monkeypatch.setattr(master_process, "spawn", noted)
    with own_master_uri():
        run(scenario())


def test_what_the_master_still_lists_of_the_dead_is_left_out(tmp_path: Path) -> None:
    """A master that was frozen when a component died has kept its registrations."""

    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("listener", LISTENER)
            await r.attach("listener", "in", "/chatter")
            master = r.backend._master
            pid = await master.process()
            os.kill(pid, signal.SIGSTOP)
            try:
                r.kill("listener")
                await until(lambda: r.exits)
            finally:
                os.kill(pid, signal.SIGCONT)
            assert "/listener" in (await master.state()).subscribers["/chatter"]
            seen = await r.backend.endpoints()
            assert "/listener" not in seen.nodes and seen.subscribers == ()
            assert await r.backend.lingering_readers("/chatter") == 1
            r.exits.clear()
            await r.start("listener", LISTENER)  # at once, under the same name
            assert await r.backend.lingering_readers("/chatter") == 0
            assert "/listener" in (await r.backend.endpoints()).nodes

    run(scenario())


def test_a_master_that_cannot_be_started_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from midstride.backends.ros1 import create_backend

    async def scenario() -> None:
        backend = create_backend(tmp_path / "components", logs=tmp_path)
        with pytest.raises(StartFailed, match=r"(?s)the ROS master did not start.*rosmaster"):
            await backend.open(lambda exited: None)

    broken = tmp_path / "python"
    broken.write_text('#!/bin/sh\necho "No module named rosmaster"; exit 1\n')
    broken.chmod(0o755)
    monkeypatch.setenv("MIDSTRIDE_ROS1_PYTHON", str(broken))
    with own_master_uri():
        run(scenario())
