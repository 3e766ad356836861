"""Real ROS 2 for tests: a back end, components from a few lines of source, and nothing left behind.

Nothing here imports ROS at the top, so that the tests can be collected where there is none.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import textwrap
import time
import uuid
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from midstride.runtime.backend_protocol import Exited, Handle, Launch
from midstride.runtime.process import reaper
from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.process.reaper import Reaper, process_info
from midstride.wire.channel import Channel
from midstride.wire.commands import AttachCommand, DetachCommand, ModesCommand, WelcomeCommand
from midstride.wire.environment import ENV_TOKEN
from midstride.wire.frames import Greeting, Registration
from midstride.wire.replies import Detached
from midstride.wire.state import GateState, LinkState

T = TypeVar("T")

TALKER = """
from midstride import Component
from std_msgs.msg import String

comp = Component("talker")
out = comp.create_output("out", String)
talk = comp.create_functionality("talk", outputs=[out])
count = 0

def normal():
    global count
    count += 1
    out.write(String(data=str(count)))

talk.set_normal_mode(normal, rate=50, outputs=[out])
talk.set_degraded_mode(lambda: None)
comp.start()
"""

LISTENER = """
from midstride import Component
from std_msgs.msg import String

comp = Component("listener")
in_ = comp.create_input("in", String, rate=10)
listen = comp.create_functionality("listen", inputs=[in_])
listen.set_normal_mode(lambda message: None, inputs=[in_])
listen.set_degraded_mode(lambda: None)
comp.start()
"""


def run(coroutine: Coroutine[Any, Any, T], seconds: float = 300.0) -> T:
    """Run a test's coroutine; one that hangs fails."""

    async def bounded() -> T:
        return await asyncio.wait_for(coroutine, seconds)

    return asyncio.run(bounded())


def publishers_are_identified() -> bool:
    """Whether rclpy tells which publisher a message came from: that of kilted does, that of jazzy does not."""
    from rclpy import subscription

    info = getattr(subscription, "MessageInfo", None)
    return info is not None and "publisher_gid" in info.__annotations__


def messages_are_numbered() -> bool:
    """Whether the middleware numbers the messages of each publisher; what is lost is known by nothing else."""
    from midstride.backends.ros2 import middleware

    return middleware.of_this_process().numbers_messages


def publishers_are_told_apart() -> bool:
    """Whether messages of two publishers of a topic are told apart, by identity or by number."""
    return publishers_are_identified() or messages_are_numbered()


def tuned_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """``environment`` with the middleware set as for a process that a manager starts."""
    from midstride.backends.ros2 import dds_profiles

    settings = dds_profiles.choose(environment, dds_profiles.of_this_process().middleware, dds_profiles.loaded_major())
    return {**environment, **settings.variables}


def without_midstride() -> dict[str, str]:
    """The environment of a process started by hand, with the middleware set as for one that a manager starts."""
    return tuned_environment({k: v for k, v in os.environ.items() if not k.startswith("MIDSTRIDE_")})


def alive(pid: int) -> bool:
    seen = process_info(pid)
    return seen is not None and seen.alive


async def until(condition: Callable[[], Any], seconds: float = 90.0) -> None:
    """Wait for what the test is waiting for, and no longer."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it did not come true in time"
        await asyncio.sleep(0.005)


async def until_async(condition: Callable[[], Awaitable[Any]], seconds: float = 90.0) -> None:
    deadline = time.monotonic() + seconds
    while not await condition():
        assert time.monotonic() < deadline, "it did not come true in time"
        await asyncio.sleep(0.01)


class Rig:
    """An opened back end with a manager's connections to its components. Made by :func:`rig`."""

    def __init__(self, backend: Any, folder: Path, token: str) -> None:
        self.backend = backend
        self.folder = folder
        self.token = token
        self.client = ComponentClient(backend.transport, backend.clock, token)
        self.exits: list[Exited] = []
        self.handles: dict[str, Handle] = {}

    def write(self, name: str, source: str) -> Path:
        path = self.folder / f"{name}.py"
        path.write_text(textwrap.dedent(source), encoding="utf-8")
        return path

    async def launch(self, instance: str, source: str, *arguments: str, **options: Any) -> Handle:
        """Start a component's process and return at once."""
        self.client.disconnect(instance)
        self.write(instance.replace("/", "_"), source)
        command = ("python3", f"{instance.replace('/', '_')}.py", *arguments)
        handle: Handle = await self.backend.start(
            Launch(instance, options.pop("namespace", ""), command, self.token, self.folder, **options)
        )
        self.handles[instance] = handle
        return handle

    async def start(self, instance: str, source: str, *arguments: str, **options: Any) -> tuple[Greeting, Registration]:
        """Start a component and welcome it."""
        await self.launch(instance, source, *arguments, **options)
        return await self.welcome(instance)

    async def welcome(self, instance: str) -> tuple[Greeting, Registration]:
        """What the component registers with, once it does; it is welcomed."""
        registering = asyncio.ensure_future(self.client.registered(instance))
        try:
            await until(lambda: registering.done() or self.exits)
        finally:
            registering.cancel()
        assert registering.done(), f"{instance} ended before it registered: {self.exits}"
        await self.client.change(instance, WelcomeCommand(manager="a test"))
        return registering.result()

    async def modes(self, instance: str, because: str = "a test asked for it", **modes: str) -> None:
        await self.client.change(instance, ModesCommand(timeout=5.0, modes=modes, because=because))

    async def attach(
        self, instance: str, port: str, topic: str, gate: GateState = "open", peers: int = 0, timeout: float = 10.0
    ) -> None:
        command = AttachCommand(timeout=timeout, port=port, topic=topic, gate=gate, peers=peers)
        await self.client.change(instance, command)

    async def detach(self, instance: str, port: str, topic: str, timeout: float = 5.0) -> Detached:
        return await self.client.change(instance, DetachCommand(timeout=timeout, port=port, topic=topic))

    async def link(self, instance: str, port: str, topic: str) -> LinkState:
        """The state of one attachment."""
        return (await self.client.observe(instance)).ports[port][topic]

    async def channel(self, instance: str) -> Channel:
        """A control connection beside the manager's."""
        transport = self.backend.transport
        return await Channel.open(transport, transport.address(instance), self.token, timeout=5.0)

    async def shows_node(self, full_name: str) -> bool:
        return full_name in (await self.backend.endpoints()).nodes

    async def shows_writer(self, full_name: str, topic: str) -> bool:
        return (full_name, topic) in (await self.backend.endpoints()).publishers

    async def shows_no_writer(self, topic: str) -> bool:
        return all(shown != topic for _, shown in (await self.backend.endpoints()).publishers)

    async def shows_reader(self, full_name: str, topic: str) -> bool:
        return (full_name, topic) in (await self.backend.endpoints()).subscribers

    def pid(self, instance: str) -> int:
        pid = self.handles[instance].pid
        assert pid is not None
        return pid

    def kill(self, instance: str, number: int = signal.SIGKILL) -> None:
        os.kill(self.pid(instance), number)

    def log(self, instance: str) -> str:
        return Path(self.handles[instance].log or "").read_text(encoding="utf-8")


@contextlib.asynccontextmanager
async def rig(folder: Path) -> AsyncIterator[Rig]:
    """A back end, opened; at the end it is closed, and everything it started is ended."""
    from midstride.backends.ros2 import create_backend

    token = f"test-{uuid.uuid4().hex}"
    with Reaper(ENV_TOKEN, token) as guarding:
        backend = create_backend(folder / "components", logs=folder / "logs", guardian=guarding)
        rig = Rig(backend, folder, token)
        await backend.open(rig.exits.append)
        try:
            yield rig
        finally:
            rig.client.close()
            await backend.close()
    assert reaper.remaining_groups({}, ENV_TOKEN, token) == set()


def shared_memory_of(pid: int) -> list[str]:
    """The files of the middleware in ``/dev/shm`` that a process has mapped."""
    lines = Path(f"/proc/{pid}/maps").read_text(encoding="utf-8").splitlines()
    return sorted({line.split()[-1] for line in lines if "/dev/shm/fast" in line})


class Bare:
    """A bare rclpy node beside the back end, in a context of its own; call :meth:`spin` to let it work."""

    def __init__(self, name: str = "bare", arguments: Sequence[str] = ()) -> None:
        import rclpy
        from rclpy.context import Context
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node
        from rclpy.signals import SignalHandlerOptions

        from midstride.backends.ros2 import dds_profiles

        self.context = Context()
        with dds_profiles.applied_profile(dds_profiles.of_this_process()):
            rclpy.init(args=[*arguments], context=self.context, signal_handler_options=SignalHandlerOptions.NO)
            self.node: Any = Node(
                name, context=self.context, use_global_arguments=False, start_parameter_services=False
            )
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    async def until(self, condition: Callable[[], Any], seconds: float = 90.0) -> None:
        """Spin, while the test's loop goes on, until ``condition`` holds."""
        deadline = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < deadline, "it did not come true in time"
            await self.spin()

    async def until_named(self, name: str, times: int = 1, seconds: float = 60.0) -> None:
        """Wait until the graph shows so many nodes of a name.

        Where it does not, a node that starts now is asked, as ``ros2 node list`` would be: if discovery has
        lost an announcement, only participants that join later see the node.
        """
        with contextlib.suppress(AssertionError):
            await self.until(lambda: self.node.get_node_names().count(name) == times, seconds)
            return
        later = Bare("asks_again")
        try:
            await later.until(lambda: later.node.get_node_names().count(name) == times, 30.0)
        except AssertionError:
            seen, new = (sorted(each.node.get_node_names()) for each in (self, later))
            raise AssertionError(f"{name} is not there {times} times: {seen}; to a new node: {new}") from None
        finally:
            later.close()

    async def spin(self) -> None:
        self.executor.spin_once(timeout_sec=0.002)
        await asyncio.sleep(0)

    async def ask(self, client: Any, request: Any, seconds: float = 90.0) -> Any:
        """A service's answer, asked for again where it is lost."""
        await self.until(client.service_is_ready, seconds)
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            future = client.call_async(request)
            again = time.monotonic() + 5.0
            while not future.done() and time.monotonic() < again:
                self.executor.spin_once(timeout_sec=0.002)
                await asyncio.sleep(0)
            if future.done():
                return future.result()
        raise AssertionError("no answer came")

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()

    def __enter__(self) -> Bare:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
