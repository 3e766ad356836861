"""The outputs of a lifecycle node without a gate: they are open while it is active.

At a hand-over between two of them, the old one is deactivated, then the new one is activated. In this order there are
never two publishers, and the topic is silent for the time that both transitions take (docs/protocols/foreign.md).
"""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass, field

from midstride.errors import CommandRefused
from midstride.foreign.foreign_state import StatePeers, moved
from midstride.foreign.gated_outputs import GatedOutputs
from midstride.foreign.lifecycle_node import LifecycleNode
from midstride.foreign.node import WATCH
from midstride.foreign.services import NoAnswer
from midstride.foreign.ungated_outputs import UngatedOutputs
from midstride.wire import commands, replies


@dataclass
class LifecycleExchange:
    """The transitions of both sides, one after the other. The topics were ``silent`` for so long (s).

    ``passed``: the old side has done its part. ``state``: of how many bytes was the state that has moved, if any.
    """

    task: asyncio.Task[None] = field(init=False)
    passed: bool = False
    silent: float = 0.0
    state: int | None = None


@dataclass
class LifecyclePeers:
    """The lifecycle nodes of a system, and the hand-overs between them, by cut."""

    nodes: dict[str, LifecycleNode] = field(default_factory=dict)
    exchanges: dict[str, LifecycleExchange] = field(default_factory=dict)


class LifecycleOutputs(UngatedOutputs):
    """The outputs of the lifecycle node ``own``: open while it is active.

    ``answering`` hands its requests over, where the library is in its process, for its services alone.
    """

    def __init__(
        self, own: LifecycleNode, peers: LifecyclePeers, states: StatePeers, answering: GatedOutputs | None = None
    ) -> None:
        super().__init__(own.node)
        self._own = own
        self._peers = peers
        self._states = states
        self._answering = answering
        self._cuts: dict[str, tuple[str | None, list[str]]] = {}  # the old side, None on that side, and the ports
        peers.nodes[own.node.record.instance] = own

    async def attach(self, command: commands.AttachCommand) -> replies.Attached:
        await self._own.set_links({command.port: command.gate})
        return replies.Attached(matched=0)

    async def detach(self, command: commands.DetachCommand) -> replies.Detached:
        await self._own.set_links({command.port: None})
        return replies.Detached(acknowledged=None, last=None)

    async def gate(self, command: commands.GateCommand) -> replies.Done:
        await self._own.set_links({command.port: command.gate})
        return replies.Done()

    async def await_rate(self, command: commands.AwaitRateCommand) -> replies.RateVerdict:
        """Judge the only thing that is known without a gate: that the node does not leave its lifecycle state."""
        left = await self._node.comes_true(self._own.left, command.timeout, every=WATCH)
        return replies.RateVerdict(reached=left == (command.until == "broken"), rate=0.0, pause=0.0)

    async def await_idle(self, command: commands.AwaitIdleCommand) -> replies.Idle:
        """Report that the node hangs if it does not answer with its state."""
        try:
            await self._own.lifecycle.look(command.timeout)
        except NoAnswer as error:
            return replies.Idle(busy=str(error))
        return replies.Idle(busy=None)

    async def grid(self, command: commands.GridCommand) -> replies.Grid:
        """Any moment will do."""
        return replies.Grid(trigger="none", now=time.time_ns())

    async def cut_out(self, command: commands.CutOutCommand) -> replies.Done:
        """The old side: nothing until the new one begins."""
        self._cuts[command.cut] = None, [swap.port for swap in command.swaps]
        return replies.Done()

    async def cut_in(self, command: commands.CutInCommand) -> replies.Done:
        """The new side: begin."""
        old = self._peers.nodes.get(command.peer)
        if old is None:
            raise CommandRefused(f"{command.peer} is no lifecycle node without a gate")
        topics = {swap.topic: swap.port for swap in command.swaps}
        theirs = [port for port, topic in old.node.record.topics.items() if topic in topics]
        ours = [swap.port for swap in command.swaps]
        self._cuts[command.cut] = command.peer, ours
        exchange = self._peers.exchanges[command.cut] = LifecycleExchange()
        making = self._make_transitions(exchange, old, theirs, ours, command.state)
        exchange.task = asyncio.get_running_loop().create_task(making)
        exchange.task.add_done_callback(lambda done: done.cancelled() or done.exception())  # retrieved
        return replies.Done()

    async def answer(self, command: commands.AnswerCommand) -> replies.Answers:
        return replies.Answers() if self._answering is None else await self._answering.answer(command)

    async def finish(self) -> None:
        if self._answering is not None:
            await self._answering.finish()

    async def _make_transitions(
        self,
        exchange: LifecycleExchange,
        old: LifecycleNode,
        theirs: list[str],
        ours: list[str],
        transfer: commands.StateTransfer | None,
    ) -> None:
        begun = asyncio.get_running_loop().time()
        await old.set_links(dict.fromkeys(theirs, "closed"))
        if transfer is not None:
            states = self._states.nodes
            own, other = self._node.record.instance, old.node.record.instance
            exchange.state = await moved(states[other], states[own], transfer.timeout)
        exchange.passed = True
        await self._own.set_links(dict.fromkeys(ours, "open"))
        exchange.silent = asyncio.get_running_loop().time() - begun
        self._own.handed_over(exchange.silent)

    async def await_cut(self, command: commands.AwaitCutCommand) -> replies.CutResult:
        """Both sides: until the new one is active, or one of them has failed to make its transition.

        Where the new one has failed, the old one is done: it does not hang, however slowly it answers.
        """
        if (exchange := self._peers.exchanges.get(command.cut)) is None:
            raise CommandRefused(f"there is no cut {command.cut}")
        await asyncio.wait({exchange.task}, timeout=command.timeout)
        if not exchange.task.done() or exchange.task.cancelled():
            because = "the transitions have not ended in time"
        elif (error := exchange.task.exception()) is not None:
            because = str(error)
        else:
            silent, state = exchange.silent, exchange.state
            words = f"{silent:.3f} s for the transitions of both lifecycle nodes, in which neither was active"
            moved_state = None if state is None else replies.MovedState(bytes=state, silent=silent, held=0.0)
            return replies.CutResult(outcome="done", because=words, moved=moved_state)
        is_new = self._cuts.get(command.cut, (None, []))[0] is not None
        return replies.CutResult(outcome="done" if exchange.passed and not is_new else "waiting", because=because)

    async def cancel_cut(self, command: commands.CancelCutCommand) -> replies.Done:
        """Either side: the new one becomes inactive again, and the old one active.

        The old one does so even if the new one does not answer: what has failed is ended next. One that has not
        answered when it was last asked is not asked again, as its topics are silent until the old one is active.
        """
        peer, ports = self._cuts.pop(command.cut, (None, []))
        exchange = self._peers.exchanges.get(command.cut)
        if exchange is not None and peer is not None:
            exchange.task.cancel()
            await asyncio.wait({exchange.task})
            closing = self._own if self._own.lifecycle.responsive else None
            if closing is None:
                self._node.set_links(dict.fromkeys(ports, "closed"))
            else:
                await closing.set_links(dict.fromkeys(ports, "closed"))
        elif ports:
            self._peers.exchanges.pop(command.cut, None)
            await self._own.set_links(dict.fromkeys(ports, "open"))
        return replies.Done()
