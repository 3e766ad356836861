"""Carrying a plan out on live components, step by step, and taking it back if a step does not hold.

Each action of the model has its counterpart here. A step is done when every component concerned
has acknowledged it; then, and only then, the model's configuration moves on. A step that fails
leaves nothing half done, and the steps before it are undone in reverse order (semantics.md F6).
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from midstride.errors import CallTimeout, MidstrideError, StepFailed, Unreachable
from midstride.model.action import (
    Action,
    Attach,
    Create,
    Degrade,
    Detach,
    Handover,
    Remove,
    SetParameters,
    Upgrade,
)
from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration, Instance
from midstride.runtime.handover import ATTACH_TIMEOUT, DETACH_TIMEOUT, hand_over
from midstride.runtime.launcher import Launcher
from midstride.runtime.link import Link

# How long a call of user code may take to return before a mode change is given up (s).
DRAIN_TIMEOUT: Final = 5.0

Moved = Callable[[Configuration], Awaitable[None]]
Told = Callable[[str, str, dict[str, Any]], None]


@dataclass(slots=True)
class Executor:
    """Carries out actions. ``moved`` is told each new configuration, ``tell`` each thing worth knowing.

    ``after_step`` looks at each step of a plan once it is done: the step has failed where it raises.
    """

    link: Link
    launcher: Launcher
    configuration: Configuration
    moved: Moved
    tell: Told
    is_gone: Callable[[str], bool] = lambda _: False
    after_step: Callable[[Configuration], Awaitable[None]] | None = None
    before_handover: Callable[[Configuration, Handover], Awaitable[None]] | None = None
    starting: Callable[[Sequence[Instance]], None] = lambda _: None
    drain_timeout: float = DRAIN_TIMEOUT
    last_numbers: dict[PortRef, int | None] = field(default_factory=dict)
    _exported: dict[str, str] = field(default_factory=dict)

    async def run(self, actions: Sequence[Action], documents: Sequence[Mapping[str, Any]] = ()) -> None:
        """Carry out ``actions`` in order.

        Raises StepFailed once everything has been taken back, or could not be: its ``outcome`` says which.
        """
        done: list[tuple[Action, Configuration]] = []
        for index, action in enumerate(actions):
            document = dict(documents[index]) if index < len(documents) else {}
            position = {"index": index, "of": len(actions), "step": document}
            self.tell("step", f"{index + 1}/{len(actions)} {self.describe(action)}", position)
            before = self.configuration
            try:
                if isinstance(action, Create):
                    await self._start_ahead(actions[index:])
                await self.perform(action)
                done.append((action, before))
                if self.after_step is not None:
                    await self.after_step(self.configuration)
            except (MidstrideError, asyncio.CancelledError) as error:
                self.tell("step_failed", f"{self.describe(action)} failed: {error}", position)
                await self._abandon_started(actions[index:])
                problem = await self._roll_back(done)
                if isinstance(error, asyncio.CancelledError):
                    raise
                outcome = "rolled_back" if problem is None else "failed"
                because = f"{self.describe(action)}: {error}"
                if problem is not None:
                    because += f"; and the roll-back failed: {problem}"
                raise StepFailed(because, outcome) from error
            self.tell("step_done", f"{index + 1}/{len(actions)} done", position)

    async def perform(self, action: Action) -> None:
        """Check one action against the model, carry it out, and move the model on. Raises MidstrideError."""
        after = action.apply(self.configuration)
        if not self._is_void(action):
            await self._carry_out(action)
        self.configuration = after
        await self.moved(after)

    def _is_void(self, action: Action) -> bool:
        """Whether nothing is to be done on the components: the action only takes something from a process that has
        ended, or the port has its endpoint on that topic, and keeps it, by another contract of the topic."""
        match action:
            case Attach(port, connector):
                return self._has_endpoint(port, connector)
            case Detach(port, connector):
                return self.is_gone(port.component) or self._has_endpoint(port, connector)
            case Degrade(modes):
                return all(self.is_gone(ref.component) for ref in modes)
            case Remove(component):
                return self.is_gone(component)
            case _:
                return False

    async def _carry_out(self, action: Action) -> None:
        match action:
            case Create():
                await self._create(action)
            case Remove():
                await self._remove(action)
            case Attach():
                await self._attach(action)
            case Detach():
                await self._detach(action)
            case Degrade() | Upgrade():
                await self._set_modes(action)
            case Handover():
                await self._hand_over(action)
            case SetParameters():
                await self.link.change(action.component, "set", parameters=dict(action.parameters))

    def _has_endpoint(self, port: PortRef, connector: str) -> bool:
        """Whether ``port`` is attached to another connector of the same topic: to its contract before or after a
        change. The components know the topic alone."""
        connectors = self.configuration.world.connectors
        return any(
            other != connector and connectors[other].topic == connectors[connector].topic
            for other in self.configuration.attached_to(port)
        )

    def describe(self, action: Action) -> str:
        """The action in words, with modes by name."""
        if isinstance(action, (Degrade, Upgrade)):
            told = [f"{ref} to {self._mode_name(ref, index)}" for ref, index in sorted(action.modes.items())]
            return f"{action.kind} {', '.join(told)}"
        return action.describe()

    def _mode_name(self, ref: FunctionalityRef, index: int) -> str:
        if ref.component not in self.configuration.instances:
            return str(index)
        return self.configuration.functionality(ref).modes[index].name

    async def _roll_back(self, done: Sequence[tuple[Action, Configuration]]) -> str | None:
        """Undo what was done, last first. None, or why it could not be undone."""
        if done:
            self.tell("rollback", f"taking back {len(done)} step{'s' if len(done) > 1 else ''}", {"of": len(done)})
        for action, before in reversed(done):
            for undoing in action.undo(before):
                try:
                    await self.perform(undoing)
                except MidstrideError as error:
                    return f"{self.describe(undoing)}: {error}"
        if done:
            self.tell("rolled_back", "everything is as before", {})
        return None

    # -- each action on live components ----------------------------------------------------------------

    async def _start_ahead(self, actions: Sequence[Action]) -> None:
        """Start the processes of all creations in a row at once: they load while the first is waited for."""
        row: list[Instance] = []
        for action in actions:
            if not isinstance(action, Create):
                break
            row.append(action.instance)
        for instance in row:
            await self.launcher.start(instance)
        self.starting(row)

    async def _abandon_started(self, actions: Sequence[Action]) -> None:
        for action in actions:
            if isinstance(action, Create) and action.instance.name not in self.configuration.instances:
                await self.launcher.abandon(action.instance.name)

    async def _create(self, action: Create) -> None:
        await self.launcher.registered(action.instance)
        state = self._exported.pop(action.instance.role, None)
        if state is not None:
            await self.link.change(action.instance.name, "import_state", state=state)

    async def _remove(self, action: Remove) -> None:
        instance = self.configuration.instances[action.component]
        if instance.component.run is None:
            raise StepFailed(
                f"{action.component} was started elsewhere (component {instance.component.name} has no `run`), "
                "so it is not ended here: end it yourself, or give the component a `run`"
            )
        try:
            exported = await self.link.read(action.component, "export_state")
            if exported.get("state") is not None:
                self._exported[instance.role] = exported["state"]
        except (CallTimeout, Unreachable) as error:  # what no longer answers must still be removable
            self.tell("note", f"the state of {action.component} is lost: {error}", {})
        await self.launcher.end(action.component)

    async def _attach(self, action: Attach) -> None:
        s, port = self.configuration, action.port
        output = s.is_output(port)
        peers = len(s.subscribers_on(action.connector) if output else s.publishers_on(action.connector))
        topic = s.world.connectors[action.connector].topic
        gate = {"gate": "open"} if output else {}
        await self._or_undone(
            self.link.change(
                port.component, "attach", timeout=ATTACH_TIMEOUT, port=port.port, topic=topic, peers=peers, **gate
            ),
            port.component,
            "detach",
            port=port.port,
            topic=topic,
        )

    async def _detach(self, action: Detach) -> None:
        port, topic = action.port, self.configuration.world.connectors[action.connector].topic
        gate = {"gate": "open"} if self.configuration.is_output(port) else {}
        reply = await self._or_undone(
            self.link.change(port.component, "detach", timeout=DETACH_TIMEOUT, port=port.port, topic=topic),
            port.component,
            "attach",
            port=port.port,
            topic=topic,
            peers=0,
            **gate,
        )
        if reply.get("last"):
            self.last_numbers[port] = int(reply["last"])
        if reply.get("acknowledged") is None and self.configuration.is_output(port):
            self.tell("note", f"{port}: nobody can tell whether its last messages on {topic} arrived", {})

    async def _set_modes(self, action: Degrade | Upgrade) -> None:
        """The functionalities of each component at once; of several components side by side."""
        wanted: dict[str, dict[str, str]] = {}
        before: dict[str, dict[str, str]] = {}
        for ref, index in action.modes.items():
            functionality = self.configuration.functionality(ref)
            wanted.setdefault(ref.component, {})[ref.functionality] = functionality.modes[index].name
            before.setdefault(ref.component, {})[ref.functionality] = self.configuration.mode(ref).name
        because = self.describe(action)
        changed: list[str] = []
        try:
            for component, modes in sorted(wanted.items()):
                changed.append(component)
                await self.link.change(
                    component,
                    "modes",
                    timeout=self.drain_timeout,
                    modes=modes,
                    because=f"the plan asked for it: {because}",
                )
        except MidstrideError:
            for component in reversed(changed):
                await self._quietly(
                    component, "modes", timeout=self.drain_timeout, modes=before[component], because="roll-back"
                )
            raise

    async def _hand_over(self, action: Handover) -> None:
        s = self.configuration
        for old, new in sorted({(swap.old.component, swap.new.component) for swap in action.swaps}):
            exported = await self.link.read(old, "export_state")
            if exported.get("state") is not None:
                await self.link.change(new, "import_state", state=exported["state"])
        if self.before_handover is not None:
            await self.before_handover(s, action)
        handed = await hand_over(self.link, s, action)
        self.last_numbers.update(handed.last)
        for warning in handed.warnings:
            self.tell("note", warning, {})

    async def _or_undone(
        self, attempt: Awaitable[dict[str, Any]], component: str, op: str, **arguments: Any
    ) -> dict[str, Any]:
        """``attempt``; where it fails, ``op`` takes back what it may have left."""
        try:
            return await attempt
        except MidstrideError:
            await self._quietly(component, op, timeout=DETACH_TIMEOUT, **arguments)
            raise

    async def _quietly(self, component: str, op: str, timeout: float, **arguments: Any) -> None:
        try:
            self.link.forget(component)
            await self.link.change(component, op, timeout=timeout, **arguments)
        except MidstrideError:
            pass
