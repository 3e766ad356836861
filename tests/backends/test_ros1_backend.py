"""The manager's side on real ROS 1: processes, the master, and what a killed node leaves."""

from __future__ import annotations

import asyncio
import contextlib
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from midstride.backends.ros1 import master_process, names
from midstride.backends.ros1.master import Master
from midstride.errors import CallTimeout, StartFailed, Unreachable
from midstride.runtime.backend import Handle
from midstride.runtime.process import Process, spawn
from midstride.runtime.reaper import environment_value
from midstride.wire.messages import Command
from tests.backends.ros1_support import free_port, own_master_uri, program, rig, wait_for
from tests.backends.ros2_support import LISTENER, TALKER, Rig, alive, run, until, until_async

pytestmark = pytest.mark.ros1

# A component whose ports are always the same: whoever gets them next is easily taken for it.
FIXED_PORTS = """
import functools, sys, rospy
rospy.init_node = functools.partial(rospy.init_node, xmlrpc_port=int(sys.argv[1]), tcpros_port=int(sys.argv[2]))
"""


def test_a_component_is_started_attached_heard_and_ended(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            announced = await r.start("talker", TALKER)
            assert announced.pid == r.pid("talker")
            assert announced.endpoints == ()
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
            assert (await r.detach("talker", "out", "/chatter"))["acknowledged"] is True
            pid = r.pid("talker")
            await r.backend.end("talker", 5.0)
            assert not alive(pid)
            assert r.exits == []  # an end that was asked for is no news
            assert await clean(r, "/talker")

    run(scenario())


async def clean(r: Rig, node: str) -> bool:
    """Whether the master knows nothing of a node any more."""
    master = r.backend._master
    return node not in (await master.state()).nodes() and await master.address_of(node) is None


def test_a_killed_component_is_known_at_once_and_the_master_has_forgotten_it_by_then(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", TALKER)
            await r.attach("talker", "out", "/chatter")
            calling = asyncio.ensure_future(r.link.read("talker", "await_write", 30.0, port="out", topic="/none"))
            r.kill("talker")
            await until(lambda: r.exits)
            assert (r.exits[0].instance, r.exits[0].status) == ("talker", -signal.SIGKILL)
            assert await clean(r, "/talker")
            with pytest.raises(Exception, match="talker"):
                await asyncio.wait_for(calling, 20.0)
            with pytest.raises(Unreachable):
                await r.backend.call("talker", Command("ping", {}, "late", r.token), 5.0)

    run(scenario())


async def subscribed(master: Master, topic: str) -> bool:
    return topic in (await master.state()).subscribers


async def kill_again_and_again(r: Rig, folder: Path, times: int) -> None:
    """Talkers on the very same ports, each killed in the middle of a sentence, beside who must not freeze."""
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
            state = await asyncio.wait_for(r.link.observe("listener"), 20.0)
            assert state["functionalities"]["listen"]["mode"] == "normal"
            r.kill(name)
            await until(lambda: r.exits)
            r.exits.clear()
            assert await clean(r, f"/{name}")
            state = await r.backend._master.state()
            assert state.nodes() - {r.backend._master.caller} <= {"/listener", "/bystander"}


@pytest.mark.timeout(120)
def test_components_are_killed_and_their_ports_reused(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await kill_again_and_again(r, tmp_path, 4)

    run(scenario(), 100)


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
                with pytest.raises(StartFailed, match=r"a node /talker is running already"):
                    await r.launch("talker", TALKER)
                bare.kill()
                bare.wait()
            assert "/talker" in (await master.state()).subscribers["/chatter"]  # for ever, if it were not for us
            await r.start("talker", TALKER)
            assert "/chatter" not in (await master.state()).subscribers

    run(scenario())


def test_subscriptions_to_parameters_do_not_keep_a_dead_node_known(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            master, nowhere = r.backend._master, f"http://127.0.0.1:{free_port()}/"
            await master.ask("subscribeParam", "/ghost", nowhere, "/some/parameter")
            assert await master.address_of("/ghost") == nowhere
            await master.forget("/ghost")
            assert await master.address_of("/ghost") is None

    run(scenario())


def test_a_component_that_does_not_answer_is_given_up_and_the_others_go_on(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", TALKER)
            await r.start("listener", LISTENER)
            r.kill("talker", signal.SIGSTOP)
            begun = time.monotonic()
            with pytest.raises(CallTimeout):
                await r.backend.call("talker", Command("ping", {}, "now", r.token), 0.5)
            assert time.monotonic() - begun > 0.4
            await r.link.observe("listener")
            r.kill("talker", signal.SIGCONT)
            await r.link.observe("talker")

    run(scenario())


# -- the master -------------------------------------------------------------------------------------------------


@pytest.mark.full
def test_a_component_on_another_master_is_not_found_and_it_is_said_why(tmp_path: Path) -> None:
    from midstride.backends.ros1 import create_backend

    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", TALKER)
            with own_master_uri():
                elsewhere = create_backend(logs=tmp_path / "elsewhere")
                await elsewhere.open(lambda event: None)
                with pytest.raises(Unreachable, match=f"ROS_MASTER_URI={r.backend._master.uri}"):
                    await elsewhere.adopt(r.handles["talker"])
                await elsewhere.end("talker", 2.0)  # that needs no master: `midstride down` ends it all the same
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
        backend = create_backend(logs=tmp_path)
        await backend.open(lambda event: None)
        assert not backend.started_master
        assert await backend._master.process() == process.pid
        await backend.close()
        assert process.poll() is None
        assert (await Master(uri, "/test").state()).nodes() == frozenset()

    with own_master_uri() as uri, foreign_master(uri) as process:
        run(scenario(process, uri))


def test_a_master_that_was_started_goes_with_the_last_who_needs_it(tmp_path: Path) -> None:
    """A second manager and a bare node join; whoever is last puts out the light, but only the one Midstride lit."""
    from midstride.backends.ros1 import create_backend

    async def scenario(uri: str) -> None:
        first, second = create_backend(logs=tmp_path), create_backend(logs=tmp_path)
        await first.open(lambda event: None)
        await second.open(lambda event: None)
        assert (first.started_master, second.started_master) == (True, False)
        pid = await first._master.process()
        assert pid is not None and environment_value(pid, master_process.ENV_STARTED) == uri.rpartition(":")[2]
        await first.close()
        assert alive(pid), "the second manager needs it"
        with program("guest", "/chatter", str(tmp_path / "heard")):
            await until_async(lambda: subscribed(second._master, "/chatter"))
            await second.close()
            assert alive(pid), "somebody else's node needs it"
        third = create_backend(logs=tmp_path)
        await third.open(lambda event: None)
        await third.close()
        assert not alive(pid), "what a dead node has left is no need"

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
            second = create_backend(logs=tmp_path / "logs")
            await second.open(r.heard)
            r.backend = second
            r.link._backend = second
            assert not second.started_master
            assert await second.adopt(Handle("nobody", 2**22 - 1, 1.0)) is False
            assert await second.adopt(handle) is True
            assert (await r.link.observe("talker"))["pid"] == r.pid("talker")
            r.kill("talker")
            await until(lambda: r.exits)
            assert (r.exits[0].instance, r.exits[0].status) == ("talker", None)  # not its child: nobody can tell
            assert await clean(r, "/talker")
            await second.close()
            assert await first._master.process() is None
            await first.open(r.heard)  # the rig closes it
            r.backend = first
            r.handles.clear()

    run(scenario())


def test_a_killed_manager_is_forgotten_by_the_next(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            master = r.backend._master
            dead = Master(master.uri, f"{names.MANAGER}1_1")
            await dead.ask(
                "registerSubscriber", dead.caller, names.ANNOUNCEMENT, names.STRING, f"http://127.0.0.1:{free_port()}/"
            )
            assert dead.caller in (await master.state()).nodes()
            await master_process.forget_dead_managers(master)
            assert (await master.state()).nodes() == {master.caller}

    run(scenario())


def test_a_master_that_is_started_for_nothing_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The manager is told to end while its master comes up, or then cannot join it."""
    from midstride.backends.ros1 import create_backend
    from midstride.backends.ros1.announcement_listener import AnnouncementListener

    started: list[int] = []

    def noted(*arguments: Any) -> Process:
        process = spawn(*arguments)
        started.append(process.pid)
        return process

    async def refused(listener: AnnouncementListener, host: str) -> None:
        raise Unreachable("the master does not take it")

    async def scenario() -> None:
        opening = asyncio.ensure_future(create_backend(logs=tmp_path).open(lambda event: None))
        await until_async(lambda: asyncio.sleep(0, bool(started)))
        opening.cancel()
        await asyncio.wait({opening})
        assert opening.cancelled() and not alive(started[0])
        monkeypatch.setattr(AnnouncementListener, "open", refused)
        with pytest.raises(Unreachable):
            await create_backend(logs=tmp_path).open(lambda event: None)
        assert len(started) == 2 and not alive(started[1])

    monkeypatch.setattr(master_process, "spawn", noted)
    with own_master_uri():
        run(scenario())


def test_a_master_that_cannot_be_started_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from midstride.backends.ros1 import create_backend

    async def scenario() -> None:
        backend = create_backend(logs=tmp_path)
        with pytest.raises(StartFailed, match=r"(?s)the ROS master did not start.*rosmaster"):
            await backend.open(lambda event: None)

    broken = tmp_path / "python"
    broken.write_text('#!/bin/sh\necho "No module named rosmaster"; exit 1\n')
    broken.chmod(0o755)
    monkeypatch.setenv("MIDSTRIDE_ROS1_PYTHON", str(broken))
    with own_master_uri():
        run(scenario())
