"""Ends what an earlier manager had left half done, and says what its end has cost: in the log, the history and `up`.

No change is under way, so no report has it. Nothing was measured while no manager ran: what that leaves unknown is said
(docs/protocols/recovery.md).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from midstride.errors import MidstrideError
from midstride.model.component import CANCELLING
from midstride.model.configuration import Instance
from midstride.runtime.change.lost_endpoints import what_ended
from midstride.runtime.change.managed_nodes import PLAN_LOOK, look_at_managers
from midstride.runtime.change.parameter_transfer import unread_parameters
from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.process.launcher import LastKnown, Launcher
from midstride.runtime.records.events import EventLog
from midstride.runtime.records.reports import killed_processes
from midstride.runtime.restore.half_done_values import HalfDoneValues
from midstride.verdicts import change_facts
from midstride.verdicts.assessment import Assessment
from midstride.wire.state import ComponentState

# The kind of the event, which is an incident of the history.
HALF_DONE: Final = "half_done"


@dataclass(frozen=True, slots=True)
class HalfDone:
    """Ends half-done instances of the system of ``client``. ``values``: the parameter values that were set on them."""

    launcher: Launcher
    client: ComponentClient
    events: EventLog
    values: HalfDoneValues

    async def end(
        self,
        instance: Instance,
        state: ComponentState,
        because: str,
        goes_on: tuple[Instance, ComponentState] | None = None,
        *,
        accepted: bool = True,
    ) -> None:
        """End ``instance``, which was last in ``state``.

        ``goes_on``: the one of its role that goes on, and its state; it gets the values that were set last.
        ``because``: what the ended one is. ``accepted``: an earlier manager had accepted it; until then, one beside
        another one of its role gets no requests, and no values are set on it. If it cannot be ended, that is said;
        `down` tries again.
        """
        name, clock, before = instance.name, self.client.clock, self.events.last
        other, stays = goes_on or (None, None)
        spare = other is not None and not accepted
        values = None if other is None or spare else self.values.between(instance, other)
        # Its agent is new, and has not seen the manager yet.
        await look_at_managers(self.client, name, instance.component, PLAN_LOOK)
        if values is not None:
            await values.carry_over()
        begun = clock.steady()
        if stays is not None and state.goals is not None and state.goals.in_progress:
            longest = instance.component.stop_times.patience + 3 * CANCELLING
            self.events.add("note", change_facts.waits_for_goals(name, because, state.goals.in_progress, longest))
        try:
            await self.launcher.end(name, asked=state.ending)
        except MidstrideError as error:
            words = f"{name}, {because}, could not be ended: {error}; `midstride down` tries again"
            self.events.add(HALF_DONE, words)
            return
        seconds = clock.steady() - begun
        if values is not None:
            await values.carry_over()
        known = self.launcher.last_known.get(name, LastKnown(None))
        if known.latest is not None:
            state = known.latest.state
        found = [*_outputs(state, stays)]
        if not spare:
            lost = dict(sorted(state.set_values().items())) if values is None else await values.lost(state)
            found += [change_facts.values_lost(name, lost)] if lost else []
            found += _unknown(instance, state, stays)
        new, beside = "this manager had just been started", None if other is None else other.component
        found += [
            *what_ended(name, instance.component, known, planned=False, new=new, beside=beside, spare=spare),
            *(change_facts.managed_end(name, reasons) for reasons in [state.managed] if reasons),
            *self._others(name),
            *(
                change_facts.killed(each.instance, each.words, unfinished=each.unfinished)
                for each in killed_processes(self.events.since(before))
            ),
        ]
        fates = [] if values is None else values.fates()
        rest = None if other is None else other.name
        self.events.add(HALF_DONE, change_facts.ended_half_done(name, because, rest, seconds, found, fates))

    def _others(self, name: str) -> Iterator[Assessment]:
        """The nodes that have ended with the process of an instance."""
        others = self.launcher.ended_with.get(name)
        if others is None:
            return
        for node in others.nodes:
            yield change_facts.ended_with(node.name, node.words, name, again=None, planned=False)
        if others.unknown is not None:
            yield change_facts.unknown_others(name, others.unknown)


def _open(state: ComponentState | None) -> set[str]:
    """The topics on which an instance may write."""
    ports = {} if state is None else state.ports
    return {topic for topics in ports.values() for topic, link in topics.items() if link.gate == "open"}


def _outputs(state: ComponentState, stays: ComponentState | None) -> Iterator[Assessment]:
    """Assess what is not known of the topics on which the instance wrote until it was ended."""
    wrote, still = _open(state), _open(stays)
    if alone := sorted(wrote - still):
        yield change_facts.handed_back(state.instance, alone, None if stays is None else stays.instance)
    if stays is not None and (both := sorted(wrote & still)):
        yield change_facts.both_wrote(state.instance, stays.instance, both)


def _unknown(instance: Instance, state: ComponentState, stays: ComponentState | None) -> Iterator[Assessment]:
    """Say what is unknown of the values that were set on the instance, and of the state that it has kept."""
    if (words := unread_parameters(instance, state)) is not None:
        yield change_facts.values_unknown(instance.name, words)
    if state.keeps_state:
        yield change_facts.state_lost(instance.name, None if stays is None else stays.instance)
