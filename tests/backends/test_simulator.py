"""The simulator itself: virtual time, determinism, processes that are none, faults, and leaving nothing behind."""

from __future__ import annotations

import array
import asyncio
import importlib
import importlib.util
import itertools
import sys
import threading
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from midstride.backends.simulator import (
    PacedLoop,
    Simulator,
    VirtualLoop,
    cooperative_thread,
    messages,
    type_imports,
    virtual_loop,
)
from midstride.errors import BackendError, CallTimeout, StartFailed, Unreachable
from midstride.model.component import KILL_AT_ONCE, StopTimes
from midstride.runtime.backend_protocol import Exited, Launch
from midstride.wire.frames import Reply
from tests.conformance import puppets
from tests.conformance.lab import TOKEN, Lab

Main = Callable[[Lab], Awaitable[None]]


def in_lab(folder: Path, main: Main, **options: Any) -> Simulator:
    """Run ``main`` with a lab on a new simulator."""
    simulator = Simulator(**options)

    async def opened() -> None:
        async with Lab(simulator, folder) as lab:
            await main(lab)

    simulator.run(opened())
    return simulator


async def start_script(lab: Lab, folder: Path, name: str, source: str, *arguments: str) -> None:
    file = folder / f"{name}.py"
    file.write_text(source, encoding="utf-8")
    await lab.backend.start(Launch(name, "", (sys.executable, str(file), *arguments), TOKEN, folder))


# -- time ------------------------------------------------------------------------------------------


def test_an_hour_takes_no_time() -> None:
    async def main() -> float:
        begun = asyncio.get_running_loop().time()
        await asyncio.gather(asyncio.sleep(3600), asyncio.sleep(1800))
        return asyncio.get_running_loop().time() - begun

    before = time.monotonic()
    assert virtual_loop.run(main()) == 3600
    assert time.monotonic() - before < 5


def test_a_deadlock_is_an_error() -> None:
    async def main() -> None:
        await asyncio.get_running_loop().create_future()

    with pytest.raises(BackendError, match=r"deadlock at 0\.0+ s: every task waits"):
        virtual_loop.run(main())


def test_real_sockets_work_beside_virtual_time() -> None:
    async def main() -> bytes:
        server = await asyncio.start_server(echo, "127.0.0.1", 0)
        reader, writer = await asyncio.open_connection(*server.sockets[0].getsockname()[:2])
        writer.write(b"hello\n")
        answer = await reader.readline()
        writer.close()
        server.close()
        return answer

    async def echo(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(await reader.readline())
        writer.close()

    assert virtual_loop.run(main()) == b"hello\n"


def test_what_goes_to_an_executor_is_done_at_once() -> None:
    async def main() -> tuple[int, float]:
        return await asyncio.to_thread(threading.get_ident), asyncio.get_running_loop().time()

    assert virtual_loop.run(main()) == (threading.get_ident(), 0.0)
    virtual = VirtualLoop()
    virtual.close()


def test_on_a_paced_loop_work_takes_no_time() -> None:
    """What blocks it for longer than the next timers are away delays none of them."""

    async def main() -> list[float]:
        loop = asyncio.get_running_loop()
        called: list[float] = []

        def block() -> None:
            before = loop.time()
            time.sleep(0.1)
            assert loop.time() == before
            called.append(before)

        timers = [asyncio.ensure_future(_later(at, block)) for at in (0.01, 0.02, 0.05)]
        await asyncio.gather(*timers)
        return called

    before = time.monotonic()
    assert virtual_loop.run(main(), PacedLoop()) == pytest.approx([0.01, 0.02, 0.05], abs=1e-6)
    assert time.monotonic() - before >= 0.3


async def _later(seconds: float, call: Callable[[], None]) -> None:
    await asyncio.sleep(seconds)
    call()


def test_on_a_paced_loop_time_passes_while_it_waits_for_a_thread() -> None:
    async def main() -> float:
        await asyncio.to_thread(time.sleep, 0.05)
        return asyncio.get_running_loop().time()

    assert virtual_loop.run(main(), PacedLoop()) >= 0.04


# -- determinism -----------------------------------------------------------------------------------


def rows_of_a_run(folder: Path, **options: Any) -> list[list[Any]]:
    found: list[list[Any]] = []

    async def main(lab: Lab) -> None:
        await lab.start("sink", puppets.sink())
        await lab.start("a", puppets.talker(rate=50))
        await lab.start("b", puppets.talker(rate=30))
        await lab.attach("sink", "in", "/chatter")
        for name in ("a", "b"):
            await lab.attach(name, "out", "/chatter", peers=1)
            await lab.mode(name, "talk", "normal")
        await lab.sleep(1.0)
        found.extend(await lab.rows("sink"))

    in_lab(folder, main, **options)
    return found


def test_the_same_seed_gives_the_same_run(tmp_path: Path) -> None:
    first = rows_of_a_run(tmp_path, jitter=0.004, seed=7)
    assert len(first) > 60 and first == rows_of_a_run(tmp_path, jitter=0.004, seed=7)
    assert first != rows_of_a_run(tmp_path, jitter=0.004, seed=8)
    assert first != rows_of_a_run(tmp_path)


def test_messages_take_their_latency_and_keep_their_order(tmp_path: Path) -> None:
    async def main(lab: Lab) -> None:
        await lab.start("sink", puppets.sink())
        await lab.start("talker", puppets.talker(rate=1000))
        await lab.attach("sink", "in", "/chatter")
        await lab.attach("talker", "out", "/chatter", peers=1)
        await lab.mode("talker", "talk", "normal")
        await lab.sleep(0.05)
        rows = await lab.rows("sink")
        offset = lab.backend.clock.ros_now() - round(lab.backend.clock.steady() * 1e9)
        delays = {(row[0] + offset - row[1]) / 1e9 for row in rows}
        assert len(rows) > 30 and min(delays) >= 0.01 and max(delays) <= 0.013
        assert [row[2] for row in rows] == list(range(1, len(rows) + 1))

    in_lab(tmp_path, main, latency=0.01, jitter=0.003, seed=3)


def test_latency_must_be_greater_than_nothing() -> None:
    with pytest.raises(BackendError, match="greater than 0"):
        Simulator(latency=0)


# -- processes -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "command", [("ros2", "run", "pkg", "node"), ("python3",), ("python3", "-c", "pass"), (), ("./node.py",)]
)
def test_what_is_no_python_script_cannot_be_simulated(tmp_path: Path, command: tuple[str, ...]) -> None:
    async def main(lab: Lab) -> None:
        with pytest.raises(StartFailed, match="the simulator"):
            await lab.backend.start(Launch("node", "", command, TOKEN, tmp_path))
        assert await lab.unreachable("node")

    in_lab(tmp_path, main)


@pytest.mark.parametrize(
    ("source", "status", "words"),
    [
        ("import sys; sys.exit(3)", 3, ""),
        ("import sys; sys.exit('no map')", 1, "no map"),
        ("raise SystemExit", 0, ""),
        ("print('hello'); 1 / 0", 1, "hello"),
        ("1 / 0", 1, "ZeroDivisionError"),
        ("def f(:", 1, "SyntaxError"),
        ("import no_such_module_anywhere", 1, "ModuleNotFoundError"),
        ("import sys; print(sys.argv[1:], __name__)", 0, "['a', 'b'] __main__"),
    ],
)
def test_exits_as_a_process_would(tmp_path: Path, source: str, status: int, words: str) -> None:
    async def main(lab: Lab) -> None:
        await start_script(lab, tmp_path, "node", source, "a", "b")
        exited = await lab.exited("node")
        assert exited.status == status and words in exited.log_tail, exited
        assert "cooperative_thread.py" not in exited.log_tail and "process.py" not in exited.log_tail, exited.log_tail

    in_lab(tmp_path, main)


@pytest.mark.parametrize(("command", "status"), [(("python3", "missing.py"), 2), (("python3", "-m", "missing_m"), 1)])
def test_a_script_that_is_not_there_exits_as_python_does(tmp_path: Path, command: tuple[str, ...], status: int) -> None:
    async def main(lab: Lab) -> None:
        await lab.backend.start(Launch("node", "", command, TOKEN, tmp_path))
        exited = await lab.exited("node")
        assert exited.status == status and "missing" in exited.log_tail, exited

    in_lab(tmp_path, main)


def test_components_do_not_share_what_python_keeps_for_a_process(tmp_path: Path) -> None:
    """Two folders each have a `helper`; output, arguments and `__main__` are each component's own."""

    async def main(lab: Lab) -> None:
        for name in ("one", "two"):
            folder = tmp_path / name
            folder.mkdir()
            (folder / "helper.py").write_text(f"name = {name!r}\ncount = 0\n", encoding="utf-8")
            source = (
                "import sys, time\nimport helper\n"
                "def work():\n    helper.count += 1\n    import helper as again\n"
                "    print(again.name, again.count, sys.argv[1], sys.modules['__main__'].work is work)\n"
                "for _ in range(3):\n    time.sleep(0.1)\n    work()\n"
            )
            await start_script(lab, folder, name, source, f"argument-{name}")
        for name in ("one", "two"):
            lines = (await lab.exited(name)).log_tail.splitlines()
            assert lines == [f"{name} {n} argument-{name} True" for n in (1, 2, 3)]
        assert "helper" not in sys.modules

    before = (sys.argv, sys.stdout, list(sys.path), sys.modules["__main__"])
    in_lab(tmp_path, main)
    assert (sys.argv, sys.stdout, list(sys.path), sys.modules["__main__"]) == before


def test_code_that_never_returns_is_abandoned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cooperative_thread, "COMPUTE_LIMIT", 0.3)
    release = threading.Event()
    monkeypatch.setattr(sys, "release_the_stuck_thread", release, raising=False)

    async def main(lab: Lab) -> None:
        await start_script(lab, tmp_path, "stuck", "import sys\nsys.release_the_stuck_thread.wait()\n")
        exited = await lab.exited("stuck")
        assert exited.status != 0 and "did not return within" in exited.log_tail

    in_lab(tmp_path, main)
    release.set()


def test_code_that_waits_for_a_processor_is_not_abandoned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a machine with other work: all of the time that it takes, it is ready to run."""
    monkeypatch.setattr(cooperative_thread, "COMPUTE_LIMIT", 0.2)
    monkeypatch.setattr(cooperative_thread, "_waits_for_a_processor", lambda thread: time.monotonic())
    release = threading.Event()
    monkeypatch.setattr(sys, "release_the_slow_thread", release, raising=False)
    threading.Timer(0.6, release.set).start()

    async def main(lab: Lab) -> None:
        await start_script(lab, tmp_path, "slow", "import sys\nsys.release_the_slow_thread.wait()\n")
        assert (await lab.exited("slow")).status == 0

    in_lab(tmp_path, main)


def test_sleeping_takes_simulated_time_and_only_there(tmp_path: Path) -> None:
    async def main(lab: Lab) -> None:
        begun = lab.clock.steady()
        await start_script(lab, tmp_path, "sleeper", "import time\ntime.sleep(1000)\ntime.sleep(0)\n")
        exited = await lab.eventually("it ends", lambda: lab.exits.get("sleeper"), patience=2000)
        assert exited.status == 0 and lab.clock.steady() - begun >= 1000

    before = time.monotonic()
    in_lab(tmp_path, main)
    assert time.monotonic() - before < 20
    begun = time.monotonic()
    time.sleep(0.01)
    assert time.monotonic() - begun >= 0.009


def test_nothing_is_left_behind(tmp_path: Path) -> None:
    sleep, threads, finders = time.sleep, set(threading.enumerate()), list(sys.meta_path)

    async def main(lab: Lab) -> None:
        await lab.start("talker", puppets.talker(rate=10, mode={"sleep": 5}))
        await lab.mode("talker", "talk", "normal")
        await lab.launch("endless", puppets.talker(endless=True))
        await lab.sleep(1.0)
        assert time.sleep is not sleep and len(set(threading.enumerate()) - threads) == 2
        lab.handles.clear()  # they are still running when the simulator is shut down

    simulator = in_lab(tmp_path, main)
    assert time.sleep is sleep and set(threading.enumerate()) == threads and sys.meta_path == finders
    assert simulator.processes == {}


def test_the_simulator_runs_on_any_loop_in_real_time(tmp_path: Path) -> None:
    async def main() -> float:
        simulator = Simulator()
        exits: list[Exited] = []
        await simulator.open(exits.append)
        try:
            arguments = puppets.command_of(sys.executable, puppets.talker())
            await simulator.start(Launch("talker", "", arguments, TOKEN, tmp_path))
            begun = time.monotonic()
            while not simulator.transport.present():
                await simulator.clock.sleep(0.01)
            await simulator.clock.sleep(0.1)
            assert not exits
            return time.monotonic() - begun
        finally:
            await simulator.shutdown()

    assert asyncio.run(main()) >= 0.1


# -- faults ----------------------------------------------------------------------------------------


def test_kill_is_at_once_and_known_soon_after(tmp_path: Path) -> None:
    async def main(lab: Lab) -> None:
        await lab.start("sink", puppets.sink())
        await lab.start("talker", puppets.talker(rate=100, on_stop={"write": "last words"}))
        await lab.attach("sink", "in", "/chatter")
        await lab.attach("talker", "out", "/chatter", peers=1)
        await lab.mode("sink", "hear", "normal")
        await lab.mode("talker", "talk", "normal")
        await lab.sleep(0.2)
        simulator = lab.backend
        assert isinstance(simulator, Simulator)
        simulator.faults.kill("talker")
        count = len(await lab.received("sink"))
        await lab.sleep(0.01)
        assert lab.exits["talker"].status == -9
        await lab.sleep(0.2)
        words = await lab.received("sink")
        assert len(words) <= count + 1 and "last words" not in words
        assert not [node for node, _ in (await simulator.endpoints()).publishers if node == "/talker"]
        with pytest.raises(BackendError, match="no component talker runs"):
            simulator.faults.kill("talker")

    in_lab(tmp_path, main)


def test_a_frozen_component_does_nothing_and_misses_nothing(tmp_path: Path) -> None:
    async def main(lab: Lab) -> None:
        simulator = lab.backend
        assert isinstance(simulator, Simulator)
        await lab.start("sink", puppets.sink())
        await lab.start("talker", puppets.talker(rate=50))
        await lab.attach("sink", "in", "/chatter")
        await lab.attach("talker", "out", "/chatter", peers=1)
        await lab.mode("sink", "hear", "normal")
        await lab.mode("talker", "talk", "normal")
        await lab.sleep(0.2)
        simulator.faults.freeze("talker", 0.3)
        with pytest.raises(CallTimeout):
            await lab.send("talker", "ping", {}, timeout=0.1)
        await lab.sleep(0.5)
        received = [row[0] for row in await lab.rows("sink")]
        gaps = sorted((later - earlier) / 1e9 for earlier, later in itertools.pairwise(received))
        assert 0.29 < gaps[-1] < 0.33 and gaps[-2] < 0.021, "missed slots are skipped, not made up for in a burst"
        count = len(await lab.received("sink"))
        simulator.faults.freeze("sink", 0.3)
        await lab.sleep(0.4)
        assert len(await lab.received("sink")) >= count + 18

    in_lab(tmp_path, main)


def test_messages_are_dropped_and_delayed(tmp_path: Path) -> None:
    async def main(lab: Lab) -> None:
        simulator = lab.backend
        assert isinstance(simulator, Simulator)
        await lab.start("sink", puppets.sink())
        await lab.start("talker", puppets.talker(rate=50))
        await lab.attach("sink", "in", "/chatter")
        await lab.attach("talker", "out", "/chatter", peers=1)
        await lab.mode("talker", "talk", "normal")
        await lab.sleep(0.2)
        simulator.faults.drop("/chatter", 3)
        await lab.sleep(0.2)
        numbers = [row[2] for row in await lab.rows("sink")]
        holes = sorted(set(range(1, numbers[-1] + 1)) - set(numbers))
        assert len(holes) == 3 and holes[2] == holes[0] + 2
        simulator.faults.delay("/chatter", 0.1)
        await lab.sleep(0.3)
        received, source, *_ = (await lab.rows("sink"))[-1]
        assert received - (source - 1_000_000_000_000_000_000) >= 100_000_000

    in_lab(tmp_path, main)


def test_requests_fail_as_injected(tmp_path: Path) -> None:
    async def main(lab: Lab) -> None:
        simulator = lab.backend
        assert isinstance(simulator, Simulator)
        await lab.start("talker", puppets.talker())
        revision = (await lab.read("talker", "observe"))["revision"]

        async def attach(timeout: float = 1.0) -> Reply:
            arguments = {"port": "out", "topic": "/chatter"}
            return await lab.send("talker", "attach", arguments, id="once", revision=revision, timeout=timeout)

        simulator.faults.fail_next("talker", "attach", "lost_request")
        begun = lab.clock.steady()
        with pytest.raises(CallTimeout):
            await attach(0.5)
        assert lab.clock.steady() - begun == pytest.approx(0.5)
        assert (await lab.read("talker", "observe"))["revision"] == revision
        simulator.faults.fail_next("talker", "attach", "lost_reply")
        with pytest.raises(CallTimeout):
            await attach(0.5)
        assert (await lab.read("talker", "observe"))["revision"] == revision + 1
        assert (await attach()).ok, "the repeat is answered as the first would have been"
        simulator.faults.fail_next("talker", how="refused", after=1)
        assert (await lab.read("talker", "ping")) == {}
        assert (await lab.send("talker", "ping", {})).refused is not None
        simulator.faults.fail_next("talker", "ping", "unreachable", times=2)
        for _ in range(2):
            with pytest.raises(Unreachable):
                await lab.send("talker", "ping", {})
        assert (await lab.read("talker", "ping")) == {}

    in_lab(tmp_path, main)


def test_a_component_killed_during_a_call_cannot_be_reached(tmp_path: Path) -> None:
    async def main(lab: Lab) -> None:
        simulator = lab.backend
        assert isinstance(simulator, Simulator)
        await lab.start("talker", puppets.talker())
        await lab.attach("talker", "out", "/chatter", gate="closed")
        call = asyncio.ensure_future(lab.read("talker", "await_write", port="out", topic="/chatter", timeout=10.0))
        await lab.sleep(0.1)
        simulator.faults.kill("talker")
        with pytest.raises(Unreachable, match="talker is gone: it has closed its control connection"):
            await call

    in_lab(tmp_path, main)


# -- messages --------------------------------------------------------------------------------------


def test_message_classes_have_ros_defaults() -> None:
    twist = messages.message_class("geometry_msgs/msg/Twist")()
    assert twist.linear.x == 0.0 and twist.linear is not messages.message_class("geometry_msgs/msg/Twist")().linear
    assert messages.message_class("geometry_msgs/msg/Pose")().orientation.w == 1.0
    image = messages.message_class("sensor_msgs/msg/Image")(width=3)
    assert image.width == 3 and image.encoding == "" and image.data == array.array("B")
    info = messages.message_class("sensor_msgs/msg/CameraInfo")()
    assert info.k.shape == (9,) and info.roi.do_rectify is False and info.d == array.array("d")
    assert messages.message_class("sensor_msgs/msg/PointField").FLOAT32 == 7  # type: ignore[attr-defined]
    assert image != messages.message_class("sensor_msgs/msg/Image")() and info == type(info)()
    with pytest.raises(TypeError, match="has no field heigth; its fields are: header, height"):
        messages.message_class("sensor_msgs/msg/Image")(heigth=1)


def test_message_packages_can_be_imported_while_it_is_open(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a machine without ROS: nobody else finds the package."""
    real = [finder for finder in sys.meta_path if not _finds(finder, "stereo_msgs")]
    monkeypatch.setattr(sys, "meta_path", real)
    monkeypatch.delitem(sys.modules, "stereo_msgs", raising=False)
    monkeypatch.delitem(sys.modules, "stereo_msgs.msg", raising=False)
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module("stereo_msgs.msg")
    with type_imports.served():
        module = importlib.import_module("stereo_msgs.msg")
        assert module.DisparityImage().header.frame_id == ""
        with pytest.raises(ModuleNotFoundError):
            importlib.import_module("stereo_msgs.srv")
        with pytest.raises(ModuleNotFoundError):
            importlib.import_module("no_such_msgs.msg")
    assert "stereo_msgs" not in sys.modules
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module("stereo_msgs.msg")


def _finds(finder: Any, package: str) -> bool:
    try:
        return finder.find_spec(package, None) is not None
    except (AttributeError, ImportError):
        return False


def test_a_subscriber_does_not_see_what_the_publisher_does_to_its_message_afterwards(tmp_path: Path) -> None:
    source = """
from midstride import Component
from std_msgs.msg import String
comp = Component("reuser")
out = comp.create_output("out", String)
f = comp.create_functionality("f", outputs=[out])
message = String()
def normal():
    message.data = "first"
    out.write(message)
    message.data = "second"
f.set_normal_mode(normal, rate=10, outputs=[out])
f.set_degraded_mode(lambda: None)
comp.start()
"""

    async def main(lab: Lab) -> None:
        await lab.start("sink", puppets.sink())
        await start_script(lab, tmp_path, "reuser", source)
        await lab.registered("reuser")
        await lab.welcome("reuser")
        await lab.attach("sink", "in", "/chatter")
        await lab.attach("reuser", "out", "/chatter", peers=1)
        await lab.mode("sink", "hear", "normal")
        await lab.mode("reuser", "f", "normal")
        await lab.sleep(0.15)
        assert await lab.received("sink") == ["first", "first"]

    in_lab(tmp_path, main)


# -- containers ------------------------------------------------------------------------------------


async def in_box(lab: Lab, *names: str) -> None:
    for name in names:
        await lab.launch(name, puppets.talker(), process="" if name == "apart" else "box")
        await lab.registered(name)


def test_a_crash_in_a_container_is_a_crash_of_all_its_components(tmp_path: Path) -> None:
    async def main(lab: Lab) -> None:
        await in_box(lab, "one", "two", "three", "apart")
        simulator.faults.kill("one")
        statuses = {name: (await lab.exited(name)).status for name in ("one", "two", "three")}
        assert statuses == {"one": -9, "two": -9, "three": -9}
        assert list(simulator.processes) == ["apart"]

    simulator = Simulator()

    async def opened() -> None:
        async with Lab(simulator, tmp_path) as lab:
            await main(lab)

    simulator.run(opened())


def test_one_leaves_a_container_that_goes_on_or_ends_with_it(tmp_path: Path) -> None:
    async def main(lab: Lab) -> None:
        await in_box(lab, "one", "two", "three")
        assert await simulator.end("one", StopTimes(0.0, 3.0)) == []
        assert sorted(simulator.processes) == ["three", "two"], "it is unloaded"
        simulator.faults.freeze("two", 60.0)
        assert simulator.is_stopped("three"), "they are one process"
        with pytest.raises(BackendError, match="two goes on in box: it can only end with three"):
            await simulator.end("two", StopTimes(0.0, 3.0))
        await simulator.end("two", KILL_AT_ONCE)
        assert (await lab.exited("three")).status == -9

    simulator = Simulator()

    async def opened() -> None:
        async with Lab(simulator, tmp_path) as lab:
            await main(lab)

    simulator.run(opened())
