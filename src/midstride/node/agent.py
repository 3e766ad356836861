"""The agent: the control side of a component. It carries out the manager's commands and answers for its state.

The rules of the envelope (wire/messages.py) are here: token, revision, repeated ids. What each
command does is in :mod:`midstride.node.command_handlers`. It never runs user code: whatever does is
handed to the data side, in bounded time.
"""

from __future__ import annotations

import asyncio
import hmac
import threading
import uuid
from collections import OrderedDict
from typing import TYPE_CHECKING, Any, Final

from midstride.errors import CommandRefused, MidstrideError
from midstride.model import component as model
from midstride.model.document import component_to_document
from midstride.node.arguments import Arguments
from midstride.node.command_handlers import CommandHandlers
from midstride.node.functionality_runner import FunctionalityRunner
from midstride.node.host import Host
from midstride.node.standalone import FLAG, Attachments, best_modes
from midstride.wire.commands import BETWEEN, CHANGING, READING
from midstride.wire.messages import Announcement, Command, Reply

if TYPE_CHECKING:
    from midstride.node.component import Component

# How often a component that has no manager yet says who it is (s).
ANNOUNCE_EVERY: Final = 0.1
# How many answers are kept for repeated commands.
REMEMBERED: Final = 1000
_NOT_OURS: Final = "this is not the token of the system that the component belongs to"


class Revision:
    """Counts the changes of a component. Both sides count up, so it has a lock; reading needs none."""

    def __init__(self) -> None:
        self.value = 0
        self._lock = threading.Lock()

    def bump(self) -> None:
        with self._lock:
            self.value += 1


class Agent:
    def __init__(
        self,
        component: Component,
        declaration: model.ComponentSpec,
        host: Host,
        token: str,
        pid: int,
        standalone: Attachments | None,
    ) -> None:
        self._component = component
        self._declaration = declaration
        self._host = host
        self._token = token
        self._start_token = token
        self._pid = pid
        self._standalone = standalone
        self._uuid = uuid.uuid4().hex
        self._revision = Revision()
        self._answers: OrderedDict[str, asyncio.Task[Reply]] = OrderedDict()
        self._turn = asyncio.Lock()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._welcomed = False
        self._stopping = asyncio.Event()
        self._free = asyncio.Event()  # released, or stopping
        self._operations = CommandHandlers(component, host, self._revision, self._degraded, self._publish_state)
        self._operations.belongs_to(token)

    # -- life --------------------------------------------------------------------------------------

    async def main(self) -> None:
        """From set-up to the end in order. Cancelled by a signal, it ends in order as well."""
        self._loop = asyncio.get_running_loop()
        operations, host = self._operations, self._host
        await host.on_data(operations.set_up)
        try:
            await host.on_data(operations.begin)
            self._publish_state()
            if self._standalone is not None:
                await self._run_alone(self._standalone)
            while not self._stopping.is_set():
                self._free.clear()
                if self._standalone is None:
                    await self._announce()
                await self._free.wait()
        except asyncio.CancelledError:
            pass  # SIGTERM, SIGINT
        await operations.end()

    async def _announce(self) -> None:
        announcement = self._announcement()
        if not self._start_token:
            self._host.logger.info(
                f"{self._host.instance} waits for a manager, degraded and unattached; "
                f"to run it by itself: {FLAG} {' '.join(f'{port}:=/{port}' for port in self._declaration.ports())}"
            )
        while not self._welcomed and not self._stopping.is_set():
            self._host.announce(announcement)
            await self._host.sleep(ANNOUNCE_EVERY)

    def _announcement(self, *, degraded: bool = False) -> Announcement:
        return Announcement(
            self._host.instance,
            self._uuid,
            self._pid,
            self._start_token,
            component_to_document(self._declaration),
            tuple(dict(endpoint) for endpoint in self._host.extra_endpoints()),
            degraded,
        )

    async def _run_alone(self, attachments: Attachments) -> None:
        for port, topics in attachments.items():
            for topic in topics:
                await self._operations.carry_out("attach", {"port": port, "topic": topic}, None)
        chosen = best_modes(self._declaration, attachments)
        modes = {name: self._declaration.functionalities[name].modes[index].name for name, index in chosen.items()}
        arguments = {"modes": modes, "because": "started alone: its best mode with what is attached"}
        await self._operations.carry_out("modes", arguments, None)
        told = ", ".join(f"{name} in mode {mode}" for name, mode in modes.items())
        self._host.logger.warning(f"{self._host.instance} runs alone, managed by nobody: {told}")

    # -- commands ----------------------------------------------------------------------------------

    async def serve(self, command: Command) -> Reply:
        """Carry out one command; whatever is wrong with it comes back as a refusal with its reason."""
        if refused := self._wrong_sender(command):
            return self._refusal(refused)
        if command.op in CHANGING:
            return await self._once(command)
        if command.op in READING or command.op in BETWEEN:
            return await self._carry_out(command, None)
        known = ", ".join(sorted(READING | CHANGING | BETWEEN))
        return self._refusal(f"there is no command {command.op!r}; the commands are: {known}")

    def _wrong_sender(self, command: Command) -> str | None:
        if self._standalone is not None:
            return f"{self._host.instance} was started with {FLAG} and is managed by nobody"
        if not self._token and command.token and command.op in ("observe", "welcome"):
            return None  # started by hand: it belongs to whoever welcomes it first, and who is to asks it before
        return None if self._is_ours(command) else _NOT_OURS

    def _is_ours(self, command: Command) -> bool:
        return bool(self._token) and hmac.compare_digest(command.token.encode(), self._token.encode())

    async def _once(self, command: Command) -> Reply:
        """A changing command: in turn, at the expected revision, and a repeat gets the first answer."""
        if not command.id:
            return self._refusal(f"`{command.op}` changes something, so it must have an id")
        answer = self._answers.get(command.id)
        if answer is None:
            # A task of its own: whoever asked may give up, and the command must not end half-way.
            answer = asyncio.get_running_loop().create_task(self._changing(command))
            self._answers[command.id] = answer
            while len(self._answers) > REMEMBERED:
                self._answers.popitem(last=False)
        return await asyncio.shield(answer)

    async def _changing(self, command: Command) -> Reply:
        async with self._turn:
            if self._stopping.is_set():
                return self._refusal("the component is ending")
            expected, own = command.revision, self._revision.value
            if expected != own:
                said = "none was given" if expected is None else f"{expected} was expected"
                return self._refusal(f"the component is at revision {own}, and {said}: look at its state again")
            return await self._carry_out(command, expected)

    async def _carry_out(self, command: Command, expected: int | None) -> Reply:
        try:
            if command.op in ("welcome", "observe"):
                result = self._welcome(command) if command.op == "welcome" else self._state()
            elif command.op == "stop":
                self._stopping.set()
                self._free.set()
                result = {}
            elif command.op == "release":
                result = await self._release(command)
            else:
                result = await self._operations.carry_out(command.op, command.arguments, expected)
        except MidstrideError as error:
            return self._refusal(str(error))
        except Exception as error:
            self._host.logger.error(f"`{command.op}` failed: {type(error).__name__}: {error}")
            return self._refusal(f"`{command.op}` failed: {type(error).__name__}: {error}")
        if command.op in CHANGING:
            self._revision.bump()
            self._publish_state()
            if command.op == "welcome":
                result["revision"] = self._revision.value
        return Reply(self._revision.value, result)

    def _refusal(self, words: str) -> Reply:
        return Reply(self._revision.value, {}, words)

    def _welcome(self, command: Command) -> dict[str, Any]:
        manager = Arguments("welcome", command.arguments).text("manager")
        if not self._token:
            self._token = command.token
            self._operations.belongs_to(command.token)
        elif not self._is_ours(command):  # of two who came at once the first has it
            raise CommandRefused(_NOT_OURS)
        if not self._welcomed:
            self._host.logger.info(f"{self._host.instance} is managed by {manager}")
        self._welcomed = True
        return self._state()

    async def _release(self, command: Command) -> dict[str, Any]:
        if self._start_token:
            raise CommandRefused("it was started by its manager, and is for it to end")
        await self._operations.release(Arguments("release", command.arguments))
        self._token = ""
        self._operations.belongs_to("")
        self._welcomed = False
        self._free.set()
        return {}

    # -- state -------------------------------------------------------------------------------------

    def _state(self) -> dict[str, Any]:
        identity = {"instance": self._host.instance, "uuid": self._uuid, "pid": self._pid}
        return {**identity, "revision": self._revision.value, **self._operations.state(), "waiting": self._waiting()}

    def _waiting(self) -> str | None:
        if self._standalone is None and not self._welcomed:
            return "no manager has welcomed it yet"
        if self._host.now() == 0:
            return "use_sim_time is on, and nothing has come on /clock yet: nothing that has a rate is called"
        return None

    def _publish_state(self) -> None:
        self._host.publish_state(self._state())

    def _degraded(self, runner: FunctionalityRunner) -> None:
        """On the data side: a functionality has degraded by itself. The revision tells at once, the rest may follow."""
        self._revision.bump()
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._tell_degraded, runner)

    def _tell_degraded(self, runner: FunctionalityRunner) -> None:
        self._host.logger.error(f"{runner.name} is in mode {runner.mode.name}: {runner.because}")
        self._publish_state()
        if self._welcomed and not self._stopping.is_set():  # whoever relies on it is the manager's to lower
            self._host.announce(self._announcement(degraded=True))
