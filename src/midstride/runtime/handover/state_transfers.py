"""The manager's part in moving state at a cut: what moves, the bulk beforehand, and what became of it.

The transfer itself is between the two components (node/handover/state_transfer.py, docs/protocols/state.md).
"""

from __future__ import annotations

import time
from collections.abc import Collection, Container
from dataclasses import dataclass, field
from typing import Final

from msgspec import structs

from midstride.errors import MidstrideError, RevisionChanged
from midstride.model.configuration import Instance
from midstride.model.specification import HANDOVER_SECONDS
from midstride.model.wording import counted
from midstride.runtime.handover.agreed_cut import ORDER_TIMEOUT, Cut
from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.records.events import EventLog
from midstride.runtime.records.reports import StateMove
from midstride.runtime.records.state_store import LeftState
from midstride.verdicts.assessment import seconds_in_words
from midstride.wire.commands import ImportStateCommand, PrepareStateCommand, StateTransfer
from midstride.wire.replies import CutResult, MovedState

# How long the bulk of a state, which moves while the old component works, may take (s).
BULK_TIMEOUT: Final = 30.0


def keeps_state(client: ComponentClient, instance: str) -> bool:
    """Return whether the component exports state, by its last report; it may have exited since."""
    return client.life[instance].keeps_state


def own_state(old: str, new: str, because: str, bulk: float | None = None) -> str:
    """Say that ``new`` continues with its own state, and what of ``old`` it lacks; ``bulk``: when the bulk moved."""
    if bulk is None:
        lacking = f"all that {old} had kept until {_time_of_day(time.time())}"
    else:
        lacking = f"what changed in the state of {old} from {_time_of_day(bulk)} to {_time_of_day(time.time())}"
    return f"{new} continues with its own state ({because}); lost is {lacking}"


async def import_state(
    client: ComponentClient, instance: Instance, left: LeftState, timeout: float, *, lenient: bool
) -> str | None:
    """Have an instance import what one before it has exported, in ``timeout`` (s).

    Returns in words that it could not, where that is no failure (``lenient``). Else raises MidstrideError.
    """
    command = ImportStateCommand(state=left.state, exporter=left.exporter, timeout=timeout)
    try:
        try:
            await client.change(instance.name, command)
        except RevisionChanged:  # it may just have imported it, as an earlier manager has asked it to
            client.forget_revision(instance.name)
            await client.change(instance.name, command)
    except MidstrideError as error:
        if not lenient:
            raise
        return f"{instance.name} did not restore its state: {error}"
    return None


def has_left_state(instance: Instance) -> str:
    """Say that an instance has imported what the last manager had left."""
    return f"{instance.name} has the state of {instance.role}, which was exported before the last manager ended"


def _moved_by_relays(cut: Cut, incoming: CutResult, outgoing: CutResult | None) -> MovedState | None:
    """The state that a program behind a relay has given, or got; None where there is none of the two, or it is not
    known. Its topics are silent from the last message of the old side to the first one of the new side.
    """
    relayed = any(cut.configuration.component(name).gate == "relay" for name in (cut.old, cut.new))
    if not relayed or outgoing is None or outgoing.moved is None:
        return None
    silences = []
    for swap in cut.swaps:
        topic = cut.configuration.topic(swap.connector)
        last, first = outgoing.last.get(f"{swap.old.port} {topic}"), incoming.first.get(f"{swap.new.port} {topic}")
        if last is not None and first is not None and last.source is not None and first.source is not None:
            silences.append(max(0.0, (first.source - last.source - cut.offset.ahead) / 1e9))
    return structs.replace(outgoing.moved, silent=max(silences, default=None))


def moved_in_words(old: str, new: str, state: MovedState) -> str:
    """Describe the state that moved to or from a node without Midstride's API, and what waited for it."""
    silent = "" if state.silent is None else f"nothing was published for {seconds_in_words(state.silent)}, and "
    held = f"requests were held for {seconds_in_words(state.held)}"
    return f"the state of {old} ({counted(state.bytes, 'byte')}) moved to {new}: {silent}{held}"


def _time_of_day(at: float) -> str:
    return time.strftime("%H:%M:%S", time.localtime(at))


@dataclass(slots=True)
class StateTransfers:
    """The transfers of one hand-over, for ``pairs`` of old and new components.

    If a transfer fails, so does the hand-over, unless state is not ``required``: then the new one continues with its
    own. ``timeout``: how long state may take to move at a cut (s); the topic is silent meanwhile.
    """

    client: ComponentClient
    events: EventLog
    pairs: Collection[tuple[str, str]] = ()
    required: bool = True
    timeout: float = HANDOVER_SECONDS["state_timeout"]
    # How state moves at the cuts of a pair; and by how much the first slot of a new component was late (s).
    agreed: dict[tuple[str, str], StateTransfer] = field(default_factory=dict)
    late: dict[str, float] = field(default_factory=dict)
    keeping: Container[str] = ()  # the components that keep state
    # By new component: what state of the old one it continues without, and why.
    own_state: dict[str, str] = field(default_factory=dict)
    # By new node, where it or the old one has no API: the state that has moved to it.
    moved: dict[str, StateMove] = field(default_factory=dict)
    _bulks: dict[str, float] = field(default_factory=dict)  # by new component: when the bulk had moved (Unix time, s)

    async def prepare(self) -> None:
        """Find out what is exported at the cuts, and move the bulks that can move before. Raises MidstrideError."""
        for old, new in sorted(self.pairs):
            try:
                await self._prepare(old, new)
            except MidstrideError as error:
                if self.required:
                    raise
                self.note_own_state(old, new, str(error))

    async def _prepare(self, old: str, new: str) -> None:
        prepare = PrepareStateCommand(peer=old, address=self.client.address(old, new))
        offer = await self.client.change(new, prepare)
        changes = offer.exports == "changes"
        if changes:
            begun = time.time()  # what changes while it moves comes later
            await self.client.change(new, structs.replace(prepare, bulk=True, timeout=BULK_TIMEOUT))
            self._bulks[new] = begun
        if offer.exports != "nothing":
            order_only = offer.exports == "order"
            self.agreed[old, new] = StateTransfer(
                id="",
                cuts=0,
                at=0,
                changes=changes,
                required=self.required and not order_only,
                timeout=ORDER_TIMEOUT if order_only else self.timeout,
                new=new,
                address=self.client.address(new, old),
                order_only=order_only,
            )
        if not offer.has_state and old in self.keeping:
            self.note_own_state(old, new, "the two have different kinds of gate")

    def note_own_state(self, old: str, new: str, because: str) -> None:
        self.own_state[new] = own_state(old, new, because, self._bulks.get(new))
        self.events.add("note", f"{new} keeps its own state: {because}")

    def note_exit(self, old: str, new: str, *, hangs: bool) -> None:
        """``old`` has exited, or ``hangs``, before its state moved, if it keeps any."""
        agreed = self.agreed.get((old, new))
        if old in self.keeping or (agreed is not None and not agreed.order_only):
            how = "hangs" if hangs else "exited before it had exported its state"
            self.note_own_state(old, new, f"{old} {how}")

    def ended(self, cut: Cut, incoming: CutResult, outgoing: CutResult | None = None) -> None:
        """A cut is done on its new side: note what is missing, and a first slot that was late by more than a period.

        Of nodes without Midstride's API, also behind relays, note what the state cost. ``outgoing``: of the old side.
        """
        if (found := incoming.moved or _moved_by_relays(cut, incoming, outgoing)) is not None:
            words = moved_in_words(cut.old, cut.new, found)
            self.moved[cut.new] = StateMove(bytes=found.bytes, silent=found.silent, held=found.held, words=words)
            self.events.add("note", words)
        ordered = cut.state is not None and cut.state.order_only
        if incoming.because is not None and not ordered and not cut.arbiter.exchange:  # that one has no state to move
            self.note_own_state(cut.old, cut.new, incoming.because)
        written = [write.source for write in incoming.first.values() if write is not None and write.source is not None]
        if cut.state is None or cut.trigger != "rate" or not cut.period or not written:
            return
        late = (min(written) - cut.at - cut.offset.ahead) / 1e9
        if late > cut.period:
            self.late[cut.new] = max(round(late, 6), self.late.get(cut.new, 0.0))
            self.events.add(
                "note", f"{cut.new} wrote its first slot {late * 1e3:.0f} ms late, after its state had moved"
            )
