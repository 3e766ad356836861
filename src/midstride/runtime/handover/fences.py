"""Fencing: an old component that hangs, or is slower than the time-outs, is replaced all the same.

The exception to "never inside a call" of docs/protocols/modes.md: its outputs are closed from its control thread,
whatever its user code is doing; where that thread does not answer either, its process is killed. One that is stopped
(SIGSTOP) could be continued at any time, and must not be heard then.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal

from midstride.errors import BackendError, CallTimeout, CommandRefused, MidstrideError, StepFailed, Unreachable
from midstride.model.component import PortRef
from midstride.model.configuration import Instance
from midstride.runtime.handover.state_transfers import keeps_state
from midstride.runtime.instance_life import FenceEvent, FenceState, LifeTable
from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.process.launcher import Launcher, stop_times
from midstride.runtime.records.events import EventLog
from midstride.runtime.records.reports import FencedInstance
from midstride.wire.commands import AwaitIdleCommand, FenceCommand

# For how long a change tries without a fence, unless the request says otherwise (s).
DEFAULT_WAIT: Final = 5.0
# How long an old side has at least to show that it is free (s), and how often a silent one is asked again.
PATIENCE: Final = 0.5
INTERVAL: Final = 0.1

# A call of user code that has been running for longer than this is named in a plan that has to wait for its end (s).
LONG: Final = 2.0


def hanging(life: LifeTable, leaving: Iterable[Instance]) -> Iterator[str]:
    """Yield which of the instances that are being removed hang now, and how much longer a change may take for each."""
    for instance in leaving:
        name = instance.name
        if instance.component.once or life.is_gone_or_fenced(name):
            continue
        state = life.responsive(name)
        busy = 0.0 if state is None else max((each.busy or 0.0 for each in state.functionalities.values()), default=0.0)
        if state is not None and busy < LONG:
            continue
        why = "does not answer" if state is None else f"hangs: a call of its code has not returned for {busy:.0f} s"
        longer = DEFAULT_WAIT + stop_times(instance.started).longest
        yield (
            f"{name} {why}; unless it returns, the change takes up to {longer:g} s longer: where it has to wait for "
            f"that, it is fenced after {DEFAULT_WAIT:g} s (`--wait`), and ended"
        )


@dataclass(frozen=True, slots=True)
class StepBudget:
    """The time that one step has without a fence, for ``instances``, which may be fenced: ``until`` (steady s)."""

    client: ComponentClient
    instances: Collection[str]
    until: float

    def timeout(self, instance: str, usual: float) -> float:
        """The time that a command to ``instance`` may wait for user code: what is left, or ``usual`` seconds."""
        if instance not in self.instances:
            return usual
        return max(PATIENCE, self.until - self.client.clock.steady())

    def is_spent(self, instance: str) -> bool:
        return instance in self.instances and self.client.clock.steady() >= self.until


@dataclass(slots=True)
class Fences:
    """The fences of one change. ``wait``: how long it tries without (s)."""

    client: ComponentClient
    launcher: Launcher
    events: EventLog
    wait: float = DEFAULT_WAIT

    def now(self) -> float:
        return self.client.clock.steady()

    def budget(self, instances: Collection[str]) -> StepBudget:
        """The time for a step that begins now, and which ``instances`` it may fence."""
        return StepBudget(self.client, instances, self.now() + self.wait)

    def hangs_already(self, instance: str) -> bool:
        """Return whether the instance reports a call that has been running for longer than this change would wait."""
        state = self.client.life.responsive(instance)
        return state is not None and any((each.busy or 0.0) > self.wait for each in state.functionalities.values())

    async def unresponsive(self, instance: str, deadline: float, leaving: Sequence[str] = ()) -> str | None:
        """The reason why ``instance`` is not free until ``deadline`` (steady s); None once it is free, or has exited.

        ``leaving``: its functionalities that are to leave their modes, which an async call begun on entry prevents.
        """
        while True:
            if self.now() >= deadline and self.client.life.is_stopped(instance):
                return f"{instance} does not answer (stopped, or hanging outside of Python)"
            try:
                idle = AwaitIdleCommand(timeout=max(PATIENCE, deadline - self.now()), leaving=[*leaving])
                busy = (await self.client.read(instance, idle)).busy
                return None if busy is None else f"{instance} hangs: {busy}"
            except (CommandRefused, Unreachable):
                return None
            except CallTimeout:
                if self.now() >= deadline:
                    return f"{instance} does not answer (stopped, or hanging outside of Python)"
            await self.client.clock.sleep(INTERVAL)

    async def fence(
        self, instance: str, because: str, attachments: Iterable[tuple[PortRef, str]]
    ) -> dict[PortRef, int | None]:
        """Keep ``instance`` from publishing on these topics; the number of each output's last message, where known.

        Raises StepFailed where that is not possible.
        """
        links = [(port.port, topic) for port, topic in attachments]
        last: dict[str, int] = {}
        how: Literal["gate", "killed"] = "gate"
        try:
            if self.client.life.responsive(instance) is None:
                raise CallTimeout(f"{instance} does not answer")
            last = (await self.client.read(instance, FenceCommand(attachments=links))).last
        except MidstrideError as error:
            await self._kill(instance, error)
            how = "killed"
        what = "its process was killed" if how == "killed" else "its outputs were closed inside a call"
        state = ", and its state could not be exported" if keeps_state(self.client, instance) else ""
        words = f"{because}; {what}{state}"
        fenced = FencedInstance(instance=instance, how=how, because=because, words=words)
        self.client.life.fence(fenced, [] if how == "killed" else links)
        self.events.add("fenced", words, instance=instance)
        return {PortRef(instance, port): last.get(f"{port} {topic}") for port, topic in links}

    async def _kill(self, instance: str, error: MidstrideError) -> None:
        if not self.client.life[instance].is_owned:
            raise StepFailed(
                f"{instance} was started elsewhere, so it cannot be killed: {error}; end its process, then try again"
            ) from error
        try:
            await self.launcher.kill(instance)
        except BackendError as failure:
            raise StepFailed(f"{instance} could neither be fenced ({error}) nor killed: {failure}") from failure

    def problems(self) -> Iterator[str]:
        """The reasons why a roll-back is incomplete."""
        for name, fenced in sorted(self.client.life.fenced.items()):
            yield f"{name} was fenced, and its topics are not handed back to it: {fenced.because}"

    async def lift(self, instances: Collection[str]) -> None:
        """No successor took over: let these publish again, if they live."""
        for name in sorted(self.client.life.fenced.keys() & set(instances)):
            life = self.client.life[name]
            if life.fence is not FenceState.GATE:
                continue  # it was killed
            try:
                await self.client.read(name, FenceCommand(attachments=life.closed, lift=True))
                self.client.life.record(name, FenceEvent.LIFTED)
                self.events.add("note", f"{name} may publish again")
            except MidstrideError as error:
                self.events.add("note", f"{name} could not be let publish again: {error}")
