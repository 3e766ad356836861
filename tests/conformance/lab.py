"""The checks, and the back end opened for one of them: starts puppets, sends them commands, and ends them."""

from __future__ import annotations

import base64
import contextlib
import json
import sys
from collections.abc import Awaitable, Callable, Coroutine, Iterable, Sequence
from functools import wraps
from pathlib import Path
from typing import Any, Final, TypeAlias

import msgspec

from midstride.errors import BackendError, CallTimeout, CommandRefused, Unreachable
from midstride.model.component import StopTimes
from midstride.runtime.backend_protocol import Backend, Exited, Handle, Launch
from midstride.wire.channel import Channel, ComponentReport
from midstride.wire.frames import Greeting, Registration, Reply, Request
from tests.conformance.puppets import Description, command_of, sink

TOKEN: Final = "the-token-of-the-laboratory"
# How long waiting for processes and discovery may take (s); a loaded machine is slow.
PATIENCE: Final = 20.0
# How long a component may take to end in order (s).
GRACE: Final = 5.0


class Lab:
    """``async with Lab(backend, workspace) as lab``: on exit, everything that it started is ended."""

    def __init__(self, backend: Backend, workspace: Path) -> None:
        self.backend = backend
        self.clock = backend.clock
        self.registrations: dict[str, tuple[Greeting, Registration]] = {}
        self.reports = 0
        self.exits: dict[str, Exited] = {}
        self.handles: dict[str, Handle] = {}
        self._workspace = workspace
        self._revisions: dict[str, int] = {}
        self._channels: dict[tuple[str, str], Channel] = {}
        self._ids = 0

    async def __aenter__(self) -> Lab:
        await self.backend.open(self.on_exit)
        return self

    async def __aexit__(self, *raised: object) -> None:
        for channel in self._channels.values():
            channel.close()
        try:
            for instance in self.handles:
                await self.backend.end(instance, StopTimes(0.0, GRACE))
        finally:
            await self.backend.close()

    def on_exit(self, event: Exited) -> None:
        self.exits[event.instance] = event

    # -- processes ---------------------------------------------------------------------------------

    async def launch(
        self, instance: str, description: Description, replaces: str = "", process: str = "", **parameters: object
    ) -> Handle:
        """Start a puppet without waiting for it. ``replaces``: the instance that answers requests until then.

        ``process``: the process of a container that it shares with others, where there are such.
        """
        arguments = command_of(sys.executable, description)
        launch = Launch(
            instance,
            "",
            arguments,
            TOKEN,
            self._workspace,
            parameters,
            node=replaces,
            standby=bool(replaces),
            process=process,
        )
        handle = await self.backend.start(launch)
        self.handles[instance] = handle
        return handle

    async def start(
        self, instance: str, description: Description, replaces: str = "", **parameters: object
    ) -> Registration:
        """Start a puppet, and welcome it once it has registered."""
        await self.launch(instance, description, replaces, "", **parameters)
        _, registration = await self.registered(instance)
        await self.welcome(instance)
        return registration

    async def registered(self, instance: str) -> tuple[Greeting, Registration]:
        async def look() -> tuple[Greeting, Registration] | None:
            if exited := self.exits.get(instance):
                raise AssertionError(f"{instance} ended before it registered: {exited}")
            with contextlib.suppress(Unreachable, CallTimeout):
                await self.channel(instance)
            return self.registrations.get(instance)

        registered: tuple[Greeting, Registration] = await self.eventually(f"{instance} registers", look)
        return registered

    async def welcome(self, instance: str) -> dict[str, Any]:
        await self.read(instance, "observe")
        return await self.change(instance, "welcome", manager="laboratory")

    async def exited(self, instance: str) -> Exited:
        exited: Exited = await self.eventually(f"the exit of {instance} is seen", lambda: self.exits.get(instance))
        return exited

    # -- commands ----------------------------------------------------------------------------------

    async def channel(self, instance: str, token: str = TOKEN) -> Channel:
        """The control connection to a component, as a client with ``token``."""
        channel = self._channels.get((instance, token))
        if channel is None or channel.closed.is_set():
            made: list[Channel] = []
            early: list[ComponentReport] = []

            def report(frame: ComponentReport) -> None:
                if not made:
                    early.append(frame)
                elif isinstance(frame, Registration):
                    self.registrations[instance] = (made[0].greeting, frame)
                else:
                    self.reports += 1

            transport = self.backend.transport
            channel = await Channel.open(transport, transport.address(instance), token, timeout=PATIENCE, report=report)
            made.append(channel)
            for frame in early:
                report(frame)
            self._channels[instance, token] = channel
        return channel

    async def send(
        self,
        instance: str,
        op: str,
        arguments: dict[str, Any],
        *,
        id: str = "",
        revision: int | None = None,
        token: str = TOKEN,
        timeout: float = PATIENCE,
    ) -> Reply:
        """Send any request, valid or not: the command is ``op`` with ``arguments``, unchecked."""
        if op in ("meet", "cut_in", "answer") and "peer" in arguments:
            arguments = {"address": self.backend.transport.address(arguments["peer"]), **arguments}
        channel = await self.channel(instance, token)
        command = msgspec.Raw(msgspec.json.encode({"command": op, **arguments}))
        return await channel.send(Request(id=id, revision=revision, command=command), timeout)

    async def reply(self, instance: str, op: str, changes: bool, **arguments: Any) -> Reply:
        self._ids += 1
        revision = self._revisions[instance] if changes else None
        reply = await self.send(instance, op, arguments, id=f"lab-{id(self)}-{self._ids}", revision=revision)
        if changes or op == "observe":
            self._revisions[instance] = reply.revision
        return reply

    async def change(self, instance: str, op: str, **arguments: Any) -> dict[str, Any]:
        """Raises CommandRefused with the component's reason."""
        return self._result(await self.reply(instance, op, True, **arguments))

    async def read(self, instance: str, op: str, **arguments: Any) -> dict[str, Any]:
        return self._result(await self.reply(instance, op, False, **arguments))

    async def refusal(self, instance: str, op: str, **arguments: Any) -> str:
        """The reason with which a changing command is refused. It must be refused, and nothing may change."""
        before = await self.read(instance, "observe")
        reply = await self.reply(instance, op, True, **arguments)
        assert reply.refused is not None, f"`{op}` {arguments} was not refused"
        after = await self.read(instance, "observe")
        assert settled(before) == settled(after), f"`{op}` was refused and changed something:\n{before}\n{after}"
        return reply.refused

    async def read_refusal(self, instance: str, op: str, **arguments: Any) -> str:
        """The reason with which a reading command is refused, which it must be."""
        reply = await self.reply(instance, op, False, **arguments)
        assert reply.refused is not None, f"`{op}` {arguments} was not refused"
        return reply.refused

    def _result(self, reply: Reply) -> dict[str, Any]:
        if reply.refused is not None:
            raise CommandRefused(reply.refused)
        return dict(msgspec.json.decode(reply.result))

    # -- common steps of checks --------------------------------------------------------------------

    async def listen(self, topic: str = "/chatter") -> None:
        """Start ``sink``, attached and in its normal mode."""
        await self.start("sink", sink())
        await self.attach("sink", "in", topic)
        await self.mode("sink", "hear", "normal")

    async def attach(self, instance: str, port: str, topic: str, peers: int = 0, gate: str = "open") -> None:
        await self.change(instance, "attach", port=port, topic=topic, gate=gate, peers=peers, timeout=PATIENCE)

    async def mode(self, instance: str, functionality: str, mode: str, timeout: float = 5.0) -> dict[str, Any]:
        return await self.change(instance, "modes", modes={functionality: mode}, timeout=timeout, because="a check")

    async def exported(self, instance: str) -> dict[str, Any]:
        """What a puppet exports: calls, received messages, imported state."""
        state = (await self.read(instance, "export_state"))["state"]
        return dict(json.loads(base64.b64decode(state)))

    async def received(self, instance: str, port: str = "in") -> list[str]:
        return list((await self.exported(instance))["received"].get(port, []))

    async def calls(self, instance: str, mode: str) -> int:
        """How often a puppet's mode was called, given as ``talk.normal``."""
        return int((await self.exported(instance))["calls"].get(mode, 0))

    async def rows(self, instance: str, port: str = "in") -> list[list[Any]]:
        return list((await self.read(instance, "records", input=port))["rows"])

    async def port(self, instance: str, port: str, topic: str) -> dict[str, Any]:
        """The state of one attachment."""
        return dict((await self.read(instance, "observe"))["ports"][port][topic])

    async def functionality(self, instance: str, name: str) -> dict[str, Any]:
        return dict((await self.read(instance, "observe"))["functionalities"][name])

    async def in_mode(self, instance: str, functionality: str, mode: str) -> bool:
        return bool((await self.functionality(instance, functionality))["mode"] == mode)

    async def sleep(self, seconds: float) -> None:
        await self.clock.sleep(seconds)

    async def eventually(
        self, what: str, look: Callable[[], Any], enough: Callable[[Any], bool] = bool, patience: float = PATIENCE
    ) -> Any:
        """The first result of ``look``, which may be async, that is ``enough``."""
        deadline = self.clock.steady() + patience
        while True:
            found = look()
            if isinstance(found, Awaitable):
                found = await found
            if enough(found):
                return found
            assert self.clock.steady() < deadline, (
                f"within {patience:g} s it has not happened that {what}: {found!r:.2000}"
            )
            await self.sleep(0.02)

    async def shows(
        self,
        nodes: Sequence[str] = (),
        publishers: Sequence[tuple[str, str]] = (),
        subscribers: Sequence[tuple[str, str]] = (),
    ) -> None:
        """Wait until the graph, which follows with a delay, has these nodes and endpoints."""

        async def seen() -> bool:
            graph = await self.backend.endpoints()
            return (
                graph.nodes.issuperset(nodes)
                and set(graph.publishers).issuperset(publishers)
                and set(graph.subscribers).issuperset(subscribers)
            )

        await self.eventually(f"the graph shows {[*nodes, *publishers, *subscribers]}", seen)

    async def unreachable(self, instance: str) -> bool:
        """Whether a request to ``instance`` fails, as it must for a component that has ended."""
        with contextlib.suppress(BackendError):
            await self.send(instance, "ping", {}, timeout=1.0)
            return False
        return True


Check: TypeAlias = Callable[[Backend, Path], Coroutine[Any, Any, None]]

CHECKS: Final[list[Check]] = []
# What a platform must pass besides that has services and ROS actions as ports.
SERVICE_CHECKS: Final[list[Check]] = []


def check(body: Callable[[Lab], Coroutine[Any, Any, None]]) -> Check:
    """Adds to ``CHECKS`` what ``body`` does in a laboratory."""
    return _added(CHECKS, body)


def service_check(body: Callable[[Lab], Coroutine[Any, Any, None]]) -> Check:
    """Adds to ``SERVICE_CHECKS`` what ``body`` does in a laboratory."""
    return _added(SERVICE_CHECKS, body)


def _added(checks: list[Check], body: Callable[[Lab], Coroutine[Any, Any, None]]) -> Check:
    @wraps(body)
    async def opened(backend: Backend, workspace: Path) -> None:
        async with Lab(backend, workspace) as lab:
            await body(lab)

    checks.append(opened)
    return opened


def assert_unbroken(words: Iterable[str]) -> None:
    """A puppet numbers its calls: no message is missing, doubled or out of order, whatever the middleware reports."""
    numbers = [int(word.rsplit(" ", 1)[1]) for word in words]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers))), numbers


def settled(state: dict[str, Any]) -> dict[str, Any]:
    """The part of a component's state that only commands change."""
    return {
        "revision": state["revision"],
        "modes": {name: entry["mode"] for name, entry in state["functionalities"].items()},
        "gates": {
            port: {topic: link["gate"] for topic, link in links.items()} for port, links in state["ports"].items()
        },
        "parameters": state["parameters"],
    }
