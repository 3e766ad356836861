"""The manager's side on real ROS 2: processes found, watched, called, ended, and found again."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from midstride.errors import CallTimeout, StartFailed, Unreachable
from midstride.runtime.backend import Handle, Launch
from midstride.runtime.component_client import ComponentClient
from midstride.wire.environment import ENV_TOKEN, Command
from tests.backends.ros2_support import LISTENER, TALKER, Bare, alive, rig, run, shared_memory_of, until, until_async

pytestmark = pytest.mark.ros2


def test_a_component_is_started_attached_heard_and_ended(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            announced = await r.start("talker", TALKER)
            assert announced.pid == r.pid("talker")
            assert announced.endpoints == ()
            assert sorted(announced.declaration["outputs"]) == ["out"]
            await r.start("listener", LISTENER)
            await r.attach("talker", "out", "/chatter")
            await r.attach("listener", "in", "/chatter", peers=1)
            await r.modes("talker", talk="normal")
            await r.modes("listener", listen="normal")
            seen = await r.backend.endpoints()
            assert seen.nodes >= {"/talker", "/listener"}
            assert seen.publishers == (("/talker", "/chatter"),)
            assert seen.subscribers == (("/listener", "/chatter"),)
            before = (await r.link.observe("listener"))["ports"]["in"]["/chatter"]["count"]

            async def more() -> bool:
                return bool((await r.link.observe("listener"))["ports"]["in"]["/chatter"]["count"] > before + 20)

            await until_async(more)
            await r.modes("talker", talk="degraded")
            assert (await r.detach("talker", "out", "/chatter"))["acknowledged"] is True
            assert (await r.backend.endpoints()).publishers == ()
            pid = r.pid("talker")
            await r.backend.end("talker", 5.0)
            assert not alive(pid)
            assert r.exits == []  # an end that was asked for is no news
            assert "/talker" not in (await r.backend.endpoints()).nodes

    run(scenario())


def test_a_killed_component_is_known_at_once_and_leaves_the_graph_soon(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", TALKER)
            calling = asyncio.ensure_future(r.link.read("talker", "await_write", 30.0, port="out", topic="/none"))
            r.kill("talker")
            await until(lambda: r.exits)
            assert "/talker" in (await r.backend.endpoints()).nodes, "it was known by the graph alone"
            assert (r.exits[0].instance, r.exits[0].status) == ("talker", -signal.SIGKILL)
            with pytest.raises(Exception, match="talker"):
                await asyncio.wait_for(calling, 20.0)
            with pytest.raises(Unreachable, match="has ended"):
                await r.backend.call("talker", Command("ping", {}, "late", r.token), 5.0)

            async def left() -> bool:
                return "/talker" not in (await r.backend.endpoints()).nodes

            await until_async(left, 15.0)  # a lease that is not tuned lasts 20 s

    run(scenario())


def test_a_name_that_is_taken_is_refused(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            with Bare("talker") as bare:
                await bare.until(lambda: "/talker" in r.backend._names())
                with pytest.raises(StartFailed, match=r"a node /talker is running already"):
                    await r.launch("talker", TALKER)
            await until(lambda: "/talker" not in r.backend._names())
            await r.start("talker", TALKER)

    run(scenario())


def test_a_name_that_the_graph_forgot_to_drop_is_free(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            known = r.backend._names
            monkeypatch.setattr(r.backend, "_names", lambda: [*known(), "/talker"])
            assert "/talker" not in (await r.backend.endpoints()).nodes
            await r.start("talker", TALKER)
            assert "/talker" in (await r.backend.endpoints()).nodes

    run(scenario())


def test_the_name_of_a_killed_component_can_be_used_again(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", TALKER)
            r.kill("talker")
            await until(lambda: r.exits)
            r.exits.clear()
            first = r.pid("talker")
            announced = await r.start("talker", TALKER)
            assert announced.pid != first
            assert (await r.link.observe("talker"))["pid"] == announced.pid

    run(scenario())


@pytest.mark.parametrize(
    ("source", "status", "told"),
    [
        ("import no_such_module_at_all", 1, "No module named 'no_such_module_at_all'"),
        ("raise SystemExit(7)", 7, ""),
        ("from midstride import Component\nComponent('talker').create_output('out', int)", 1, "out"),
    ],
)
def test_a_component_that_fails_on_its_way_up_is_told_with_its_log(
    tmp_path: Path, source: str, status: int, told: str
) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.launch("talker", source)
            await until(lambda: r.exits)
            assert r.exits[0].status == status
            assert told in r.exits[0].log_tail
            assert "talker" not in r.announced

    run(scenario())


def test_a_program_that_is_not_there(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            with pytest.raises(StartFailed, match="no program no-such-program"):
                await r.backend.start(Launch("talker", "", ("no-such-program",), r.token, tmp_path))

    run(scenario())


def test_calling_what_is_not_there(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            with pytest.raises(Unreachable, match="/nobody"):
                await r.backend.call("nobody", Command("ping", {}, "1", r.token), 0.5)

    run(scenario())


def test_a_component_that_is_stopped_does_not_answer_in_time_but_answers_later(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", TALKER)
            r.kill("talker", signal.SIGSTOP)
            begun = time.monotonic()
            with pytest.raises(CallTimeout, match="talker"):
                await r.backend.call("talker", Command("ping", {}, "1", r.token), 0.7)
            assert time.monotonic() - begun > 0.6
            r.kill("talker", signal.SIGCONT)
            assert (await r.backend.call("talker", Command("ping", {}, "2", r.token), 10.0)).ok

    run(scenario())


def test_a_command_that_is_sent_again_is_carried_out_once(tmp_path: Path) -> None:
    """The component is stopped while a command is sent, and sent again; going on, it finds several of it."""

    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", TALKER)
            revision = (await r.link.observe("talker"))["revision"]
            r.kill("talker", signal.SIGSTOP)
            command = Command("attach", {"port": "out", "topic": "/chatter"}, "once", r.token, revision)
            first = asyncio.ensure_future(r.backend.call("talker", command, 30.0))
            second = asyncio.ensure_future(r.backend.call("talker", command, 30.0))
            await asyncio.sleep(1.5)
            r.kill("talker", signal.SIGCONT)
            assert await first == await second
            assert (await first).ok
            state = await r.link.observe("talker")
            assert state["revision"] == revision + 1
            assert list(state["ports"]["out"]) == ["/chatter"]

    run(scenario())


def test_observing_does_not_wait_for_user_code(tmp_path: Path) -> None:
    sleeping = TALKER.replace("    global count\n", "    global count\n    __import__('time').sleep(600)\n")

    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", sleeping)
            await r.attach("talker", "out", "/chatter")
            await r.modes("talker", talk="normal")

            async def busy() -> bool:
                return (await r.link.observe("talker"))["functionalities"]["talk"]["busy"] is not None

            while not await busy():
                await asyncio.sleep(0.01)
            for _ in range(20):
                view = (await r.link.observe("talker"))["functionalities"]["talk"]
                assert view["mode"] == "normal" and view["busy"] is not None

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

            exits = []
            later = create_backend(logs=tmp_path / "later")
            await later.open(lambda event: exits.append(event) if not hasattr(event, "uuid") else None)
            try:
                assert not await later.adopt(Handle("talker", handle.pid, (handle.started or 0.0) + 1.0, handle.log))
                assert not await later.adopt(Handle("another", handle.pid, handle.started, handle.log))
                assert await later.adopt(handle)
                state = await ComponentClient(later, r.token).observe("talker")
                assert state["ports"]["out"]["/chatter"]["gate"] == "open"
                r.kill("talker")
                await until(lambda: exits)
                assert (exits[0].instance, exits[0].status) == ("talker", None)
                assert not await later.adopt(handle)
            finally:
                await later.close()

    run(scenario())


def test_a_component_that_was_started_elsewhere_is_adopted_by_its_name(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            assert not await r.backend.adopt(Handle("talker"))
            r.write("talker", TALKER)
            environment = {**os.environ, ENV_TOKEN: r.token}
            with subprocess.Popen([sys.executable, "talker.py"], cwd=tmp_path, env=environment) as process:
                try:
                    assert await r.backend.adopt(Handle("talker"))
                    assert (await r.link.observe("talker"))["pid"] == process.pid
                finally:
                    process.terminate()
                    assert process.wait(10) == 0

    run(scenario())


def test_namespaces(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            announced = await r.start("front/talker", TALKER, namespace="front")
            assert announced.instance == "front/talker"
            await r.attach("front/talker", "out", "/chatter")
            await r.start("listener", LISTENER)
            await r.link.change("front/talker", "meet", timeout=5.0, peer="listener")
            seen = await r.backend.endpoints()
            assert "/front/talker" in seen.nodes
            assert seen.publishers == (("/front/talker", "/chatter"),)

    run(scenario())


def test_components_use_sockets_alone(tmp_path: Path) -> None:
    """Shared memory loses first replies and leaves files behind when a process is killed (tuning.py)."""

    async def scenario() -> None:
        async with rig(tmp_path) as r:
            assert r.backend.tuning.middleware == "rmw_fastrtps_cpp"
            assert r.backend.tuning.untuned == ()
            await r.start("talker", TALKER)
            assert shared_memory_of(r.pid("talker")) == []
            assert shared_memory_of(os.getpid()) == []

    run(scenario())


MANAGER = """
import asyncio, sys
from pathlib import Path
from midstride.backends.ros2 import create_backend
from midstride.runtime.backend import Launch
from midstride.runtime.reaper import Guardian
from midstride.wire.environment import ENV_TOKEN

async def main(token):
    heard = asyncio.Event()
    backend = create_backend(logs=Path("logs"), guardian=Guardian(ENV_TOKEN, token))
    await backend.open(lambda event: heard.set())
    handle = await backend.start(Launch("talker", "", ("python3", "talker.py"), token, Path.cwd()))
    await heard.wait()
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
