"""The manager's conversation with its components: every command with token, id and expected revision."""

from __future__ import annotations

import uuid
from typing import Any, Final

from midstride.errors import BackendError, CallTimeout, CommandRefused, Unreachable
from midstride.runtime.backend import Backend
from midstride.wire.messages import Command, Reply

# How long a component may take to answer what needs no user code (s), on top of a command's own time-out.
ANSWER_TIMEOUT: Final = 3.0
# How often something is taken back where an earlier command ends only meanwhile.
TAKE_BACK_ATTEMPTS: Final = 2


class ComponentClient:
    """Knows the revision each component is at, so that a change is refused where the component has moved on."""

    def __init__(self, backend: Backend, token: str, manager: str | None = None) -> None:
        self._backend = backend
        self._token = token
        self._prefix = manager or uuid.uuid4().hex[:12]
        self._count = 0
        self._revisions: dict[str, int] = {}

    async def read(self, instance: str, op: str, timeout: float = 0.0, **arguments: Any) -> dict[str, Any]:
        """Ask a component something that changes nothing.

        Raises CommandRefused, CallTimeout or Unreachable, each naming the component and the command.
        """
        return await self._send(instance, op, timeout, None, arguments)

    async def change(self, instance: str, op: str, timeout: float = 0.0, **arguments: Any) -> dict[str, Any]:
        """Have a component do something; ``timeout`` (s) is what the command itself may take. Raises as ``read``."""
        if instance not in self._revisions:
            await self.observe(instance)
        return await self._send(instance, op, timeout, self._revisions.get(instance), arguments)

    async def observe(self, instance: str, timeout: float = 0.0) -> dict[str, Any]:
        """The component's own state; the revision it tells is the one expected from now on."""
        state = await self.read(instance, "observe", timeout)
        self._revisions[instance] = int(state["revision"])
        return state

    async def peek(self, instance: str) -> dict[str, Any]:
        """The component's own state, for showing: what is expected of its revision stays as it is."""
        return await self._send(instance, "observe", 0.0, None, {})

    def accept(self, instance: str, state: dict[str, Any]) -> None:
        """What a component has said of itself is known now: its revision is the one expected from now on."""
        self._revisions[instance] = int(state["revision"])

    async def take_back(self, instance: str, op: str, timeout: float = 0.0, **arguments: Any) -> None:
        """Have a component put something back, wherever it stands by now; what it will not or cannot do is left.

        A command that was given up may still be under way there. It is carried out first, and the component has moved
        on: then it is asked again.
        """
        for _ in range(TAKE_BACK_ATTEMPTS):
            self.forget(instance)
            try:
                await self.change(instance, op, timeout=timeout, **arguments)
            except CommandRefused:
                continue
            except BackendError:
                pass
            return

    def forget(self, instance: str) -> None:
        self._revisions.pop(instance, None)

    async def _send(
        self, instance: str, op: str, timeout: float, revision: int | None, arguments: dict[str, Any]
    ) -> dict[str, Any]:
        self._count += 1
        if timeout:
            arguments = {**arguments, "timeout": timeout}
        command = Command(op, arguments, f"{self._prefix}-{self._count}", self._token, revision)
        try:
            reply = await self._call(instance, command, timeout + ANSWER_TIMEOUT)
        except CallTimeout:
            self.forget(instance)  # it may or may not have carried the command out
            waited = timeout + 2 * ANSWER_TIMEOUT
            raise CallTimeout(f"{instance} did not answer `{op}` within {waited:g} s, asked twice") from None
        except Unreachable as error:
            self.forget(instance)
            raise Unreachable(f"{instance} cannot be reached for `{op}`: {error}") from None
        if revision is not None:
            self._revisions[instance] = reply.revision
        if reply.refused is not None:
            self.forget(instance)  # it is elsewhere than was thought: the next change looks first
            raise CommandRefused(f"{instance} refused `{op}`: {reply.refused}")
        return dict(reply.result)

    async def _call(self, instance: str, command: Command, timeout: float) -> Reply:
        """A lost command or answer costs one repetition: the component knows the command by its id."""
        try:
            return await self._backend.call(instance, command, timeout)
        except CallTimeout:
            return await self._backend.call(instance, command, ANSWER_TIMEOUT)
