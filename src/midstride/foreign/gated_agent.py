"""The agent of a node that has none inside it: in the manager's process, it answers the commands of the control plane.

So the executor, the hand-over and the reconciler need not know what kind of node they talk to. What it changes is in
shared memory and in a file, so if the manager ends the node keeps running, and the next manager's agent continues
(docs/protocols/foreign.md).
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

from midstride.codec.component_form import NamedComponentForm
from midstride.errors import CommandRefused, MidstrideError
from midstride.foreign.agent_commands import ForeignCommands
from midstride.foreign.declared_servers import DeclaredServers
from midstride.foreign.foreign_parameters import ForeignParameters
from midstride.foreign.foreign_state import ForeignState, StatePeers
from midstride.foreign.gated_outputs import GatedOutputs
from midstride.foreign.gated_reflex import broken_assumptions
from midstride.foreign.gates import Gates
from midstride.foreign.graph_check import DeclaredEndpoints, GraphEndpoint, NodeGraph, Served, endpoints_seconds
from midstride.foreign.graph_watch import GRAPH_TIMEOUT, GRAPH_UNCHANGED, LOOK, GraphWatch
from midstride.foreign.lifecycle_managers import LifecycleManagers
from midstride.foreign.lifecycle_node import LifecycleNode
from midstride.foreign.lifecycle_outputs import LifecycleOutputs, LifecyclePeers
from midstride.foreign.lifecycle_transitions import ACTIVE, INACTIVE, STATE_TIMEOUT, NodeLifecycle
from midstride.foreign.node import WATCH, ForeignNode, of_topics, without_ports
from midstride.foreign.preloading import why_unseen
from midstride.foreign.record import ForeignRecord
from midstride.foreign.replaced_node import lacks
from midstride.foreign.reported_states import ReportedStates
from midstride.foreign.services import NoAnswer, NodeServices
from midstride.foreign.ungated_outputs import UngatedOutputs
from midstride.node.handover.baton import BatonStep
from midstride.wire import commands, frames
from midstride.wire.command_server import CommandServer
from midstride.wire.commands import Command
from midstride.wire.frames import Reply, Request
from midstride.wire.state import GateState, WireValue
from midstride.wire.transport import Transport

HEARTBEAT: Final = 0.5
# How often it asks any other node for its parameters (s).
PARAMETERS_LOOK: Final = 2.0
# How long a report may take to the manager, whose process this is, before the process of the node ends (s).
REPORTED: Final = 0.1
_REMEMBERED: Final = 1000


class ForeignAgent:
    """Answers for the node of ``record``, whose file is in ``folder``. ``gates`` is None for `gate none`."""

    def __init__(
        self,
        record: ForeignRecord,
        folder: Path,
        gates: Gates | None,
        services: NodeServices | None = None,
        peers: LifecyclePeers | None = None,
        graph: NodeGraph | None = None,
        others: ReportedStates | None = None,
        served: Callable[[], Served] | None = None,
        before: Sequence[GraphEndpoint] = (),
        predecessor: NodeServices | None = None,
        managers: LifecycleManagers | None = None,
        states: StatePeers | None = None,
        requests: Gates | None = None,
    ) -> None:
        """``served``: what the node serves; ``managers``: what is known of lifecycle managers; ``states``: of state.

        Of the one that it replaces, ``before`` has the endpoints, and ``predecessor`` what it can be asked.
        """
        self.node = ForeignNode(record, folder, gates, others or ReportedStates(), requests)
        self._states = states or StatePeers()
        outputs = UngatedOutputs(self.node) if gates is None else GatedOutputs(self.node, gates, self._states)
        self._services = services
        self.lifecycle: LifecycleNode | None = None
        self._parameters: ForeignParameters | None = None
        if services is not None:
            self._parameters = ForeignParameters(self.node, services)
            self.node.settings_in = services.settings_in
        if services is not None and self.node.component.has_lifecycle:
            self.lifecycle = LifecycleNode(self.node, services)
            if gates is None:
                answering = None if requests is None else GatedOutputs(self.node, requests, self._states)
                outputs = LifecycleOutputs(self.lifecycle, peers or LifecyclePeers(), self._states, answering)
        self._state: ForeignState | None = None
        if services is not None and served is not None:
            self._state = self._states.nodes[record.instance] = ForeignState(self.node, services, served)
        self._graph = graph
        self.node.looked = graph is None
        self._served = served
        self._before = before
        self._predecessor = predecessor
        self._managers = managers
        self._declared = DeclaredEndpoints(of_topics(self.node.component), record.topics, record.node)
        self._servers = DeclaredServers(self.node.component, record.topics, record.node)
        self._graph_watch = GraphWatch(
            self.node, graph, served, self._declared, self._servers, managers, services, self._state, self._report
        )
        self._failed: str | None = None  # why it has not been configured, or is not what is declared
        self._replies: dict[str, asyncio.Task[Reply]] = {}
        self._lock = asyncio.Lock()
        self._registered = asyncio.Event()
        self._tasks: list[asyncio.Task[None]] = []
        self._reported: dict[str, GateState | None] = {}
        greeting = frames.Greeting(
            protocol=frames.PROTOCOL,
            instance=record.instance,
            uuid=record.uuid,
            pid=record.pid,
            start_token=record.token,
        )
        self._server = CommandServer(greeting, self._serve)
        self._outputs = outputs
        self._commands = ForeignCommands(
            self.node, outputs, self._parameters, self.lifecycle, self._state, self._states, self._report
        )

    async def finish(self) -> None:
        """Before its process is ended. Raises CommandRefused where a lifecycle node has not made its transitions."""
        await self._outputs.finish()
        requests = self.node.requests
        if self.node.unfinished is not None or (requests and requests.page.goal_counts(requests.index)):
            self._report()
            await asyncio.sleep(REPORTED)
        if self.lifecycle is not None and self.lifecycle.lifecycle.responsive:
            await self.lifecycle.finish()

    async def open(self, transport: Transport) -> None:
        """Listen for the manager, and register as soon as the node has the endpoints that are declared.

        A hand-over that an earlier manager has not finished is withdrawn, unless the new node has written already.
        """
        if self.node.gates is not None:
            for baton in {self.node.gates.baton(port) for port in self.node.gates.component.outputs} - {0}:
                self.node.gates.step(baton, BatonStep.WITHDRAW)
        if self._managers is not None and self._graph is not None:
            self._managers.starting[self.node.record.instance] = self.node.record.role
        await self._server.open(transport)
        loop = asyncio.get_running_loop()
        self._tasks = [
            loop.create_task(each)
            for each in (
                self._register(),
                self._heartbeat(),
                self._watch_lifecycle(),
                self._watch_parameters(),
                self._watch_graph(),
                self._watch_inputs(),
            )
        ]

    async def close(self) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        if self._managers is not None:
            self._managers.starting.pop(self.node.record.instance, None)
        if self._states.nodes.get(self.node.record.instance) is self._state:
            self._states.nodes.pop(self.node.record.instance, None)
        await self._server.close(0.0)
        for services in (self._services, self._predecessor):
            if services is not None:
                services.close()

    async def _register(self) -> None:
        missing: list[str] = []
        begun = asyncio.get_running_loop().time()
        if self.lifecycle is not None:
            try:
                await (self.lifecycle.configure() if not self.node.record.welcomed else self.lifecycle.look())
            except CommandRefused as error:
                self._failed = str(error)
        if self._parameters is not None and self.lifecycle is not None:
            await self._parameters.read()
        try:
            await self._follow()
        except CommandRefused as error:
            self._failed = str(error)
        if self.node.gates is not None and self._failed is None:
            missing = await self._missing(self.node.gates)
            missing = await self._compare(missing, asyncio.get_running_loop().time() - begun)
        if self._failed is None:
            self._failed = await self._without_servers(begun)
        if not self.node.component.ports() and self._failed is None:
            self._failed = await self._not_up()
        self._graph_watch.registered()
        self._registered.set()
        self._report()
        declaration = NamedComponentForm.of(without_ports(self.node.component, missing))
        self._server.register(frames.Registration(declaration=declaration, endpoints=[]))

    async def _without_servers(self, begun: float) -> str | None:
        """Wait until the graph shows the declared servers, as long as a program that was started at ``begun`` may take.

        Why they are not as declared is returned. A node that has been accepted keeps running.
        """
        if (served := self._served) is None or self.node.record.welcomed or not self._servers.ports:
            return None
        waited = asyncio.get_running_loop().time() - begun
        longest = max(GRAPH_TIMEOUT, endpoints_seconds(self.node.component) - waited)
        await self.node.comes_true(lambda: self._servers.shown(served()), longest, every=WATCH)
        differences = self._servers.differences(served())
        if differences and self._graph is not None and not self._graph():
            differences = [self._declared.without_node(asyncio.get_running_loop().time() - begun)]
        return "; ".join(differences) or None

    async def _not_up(self) -> str | None:
        """Wait until a node without ports is up, and has taken the place of the one that it replaces; why it has not.

        Of one that the graph does not show, such as a program without ROS, it is only known that its process runs, for
        as long as was waited.
        """
        record, graph = self.node.record, self._graph
        if graph is None or record.welcomed:
            return None
        old, before, longest = record.predecessor, self._before, endpoints_seconds(self.node.component)
        if old is None:
            await self.node.comes_true(lambda: bool(graph()), GRAPH_UNCHANGED, every=WATCH)
            return None
        up = await self.node.comes_true(
            lambda: bool(found := graph()) and not lacks(found, record.node, before, old),
            longest if before else GRAPH_UNCHANGED,
            every=WATCH,
        )
        if up or not before:
            return None
        missing = lacks(graph(), record.node, before, old)
        late = f"if it takes longer to start, state `takes {2 * longest:g} s` after its `run` command"
        what = f"{old} {', '.join(missing)}, and it does not"
        return f"node {record.node} is not up within {longest:g} s: {what}; {late}"

    async def _missing(self, gates: Gates) -> list[str]:
        """The ports for which the node creates no endpoint in the time that it has.

        It is not waited for any longer if the graph has shown nothing new of it for GRAPH_UNCHANGED, and shows
        endpoints that the gate does not see; or the node answers requests, so its initialization is over, and has what
        is probably meant under other names.
        """
        loop = asyncio.get_running_loop()
        begun = since = loop.time()
        before: set[GraphEndpoint] = set()
        while not await self.node.comes_true(lambda: not gates.missing(), HEARTBEAT):
            found = set() if self._graph is None or self.node.record.welcomed else set(self._graph())
            now = loop.time()
            if found != before:
                before, since = found, now
            missing = gates.missing()
            if now - begun >= endpoints_seconds(self.node.component):
                break
            if now - since < GRAPH_UNCHANGED:
                continue
            if self._declared.unseen(list(found), missing) or self._never_seen(now - begun):
                break
            if all(self._declared.misnamed(list(found), port) for port in missing) and await self._answers():
                break
        return gates.missing()

    def _never_seen(self, ran: float) -> bool:
        """Return whether the library certainly sees nothing of the process, ``ran`` s after its start."""
        unseen, takes = why_unseen(self.node.record.pid), self.node.component.startup_seconds or 0.0
        return unseen is not None and unseen.certain_after is not None and ran >= unseen.certain_after + takes

    async def _answers(self) -> bool:
        if self._services is None:
            return False
        try:
            await self._services.parameters(LOOK)
        except NoAnswer:
            return False
        return True

    async def _compare(self, missing: list[str], waited: float) -> list[str]:
        """Compare what the graph shows with what is declared; the ports that it then lacks without a reason given.

        ``waited``: for how long it was waited for those that are ``missing`` (s).

        What the graph does not show in time is not judged. A node that has been accepted keeps running.
        """
        declared = self._declared
        if (graph := self._graph) is None or self.node.record.welcomed:
            return missing
        if not missing:
            await self.node.comes_true(lambda: declared.shown(graph()), GRAPH_TIMEOUT, every=WATCH)
        found = graph()
        past = declared.unseen(found, missing)
        unseen = why_unseen(self.node.record.pid) if missing else None
        why = None if unseen is None else unseen.why
        faults = declared.unseen_in_words(past, why)
        whole = waited if waited >= endpoints_seconds(self.node.component) else None
        absent = declared.lacking(found, [port for port in missing if port not in past], whole)
        if missing and not found:  # another node of its name may have the endpoints
            absent = [declared.without_node(whole)]
        faults += absent if why is None else [f"{fault}; {why}" for fault in absent]
        faults += declared.differences(found) + self.node.past_the_gate()
        self._failed = "; ".join(faults) or None
        return []

    async def _follow(self) -> None:
        """Take a node that another program manages to the state of the one that it replaces, behind its gate.

        Nothing else would: a lifecycle manager knows the old one, by its name. Raises CommandRefused.
        """
        component, record = self.node.component, self.node.record
        if component.has_lifecycle or record.welcomed or self._predecessor is None or self._served is None:
            return
        try:
            state = await self._predecessor.lifecycle_state(STATE_TIMEOUT)
        except NoAnswer:
            return
        if state not in (INACTIVE, ACTIVE) or self._services is None:
            return
        served, gates = self._served, self.node.gates

        def ready() -> bool:
            """Return whether it is a lifecycle node, or a plain one that has made its endpoints."""
            return served().has_lifecycle or (
                gates is not None and bool(gates.component.ports()) and not gates.missing()
            )

        await self.node.comes_true(ready, endpoints_seconds(component), every=WATCH)
        if served().has_lifecycle:
            startup, activate = component.startup_seconds or 0.0, component.activate_seconds
            own = NodeLifecycle(record.instance, self._services, startup, activate)
            await own.reach(state, own.services_timeout)

    def has_no_lifecycle(self) -> bool:
        """Return whether the running node is certainly not a lifecycle node, which creates its services first.

        It has made its endpoints, and its library has seen no such service; or the graph shows nothing new of it.
        """
        gates = self.node.gates
        if gates is not None and self.node.record.welcomed and gates.component.ports() and not gates.missing():
            seen = gates.seen_services(self.node.record.process_index)
            if seen:
                return f"{self.node.record.node}/get_state" not in seen
        if self._graph is None or self._served is None or self._managers is None or self._graph_watch.may_show_more():
            return False
        return bool(self._graph()) and not self._served().has_lifecycle

    async def _heartbeat(self) -> None:
        """Report twice a second, and soon after a baton has moved, which the nodes do without a command.

        A record that the disk has refused is written again.
        """
        await self._registered.wait()
        while True:
            await self.node.comes_true(lambda: self.node.gate_states() != self._reported, HEARTBEAT, every=WATCH)
            if self.node.unwritten is not None:
                self.node.write_record()
            self._report()

    async def _watch_graph(self) -> None:
        await self._registered.wait()
        await self._graph_watch.watch()

    async def _watch_lifecycle(self) -> None:
        """Look now and then which lifecycle state and which parameters the node has: others may change them."""
        await self._registered.wait()
        while self.lifecycle is not None and self._parameters is not None and self._failed is None:
            await asyncio.sleep(LOOK)
            async with self._lock:
                left = await self.lifecycle.look()
                self.node.answered(self.lifecycle.lifecycle.responsive)
                if self.lifecycle.lifecycle.responsive:
                    await self._parameters.read()
                if left:
                    self._changed()

    async def _watch_parameters(self) -> None:
        """Look now and then which parameters a node has that is no lifecycle node: any ROS tool may set some."""
        await self._registered.wait()
        while self.lifecycle is None and self._parameters is not None and self._failed is None:
            before = self.node.parameters, self.node.declared, self.node.unread_parameters
            await self._parameters.read()
            if before != (self.node.parameters, self.node.declared, self.node.unread_parameters):
                self._report()
            await asyncio.sleep(PARAMETERS_LOOK)

    async def _watch_inputs(self) -> None:
        """Degrade what relies on a publisher that has fallen silent; the manager restores it once that is back."""
        await self._registered.wait()
        while self.node.gates is not None:
            await asyncio.sleep(HEARTBEAT)
            async with self._lock:
                for name, (mode, because) in broken_assumptions(self.node).items():
                    try:
                        await self._commands.modes(commands.ModesCommand(modes={name: mode}, because=because))
                    except CommandRefused as error:  # its gates are closed without its help
                        last = self.node.component.functionalities[name].modes[-1].name
                        self.node.enter_modes({name: last}, f"{because}; {error}")
                    self._changed(fallen={**self.node.record.fallen, name: because})

    # -- requests --------------------------------------------------------------------------------------

    async def _serve(self, request: Request, token: str) -> Reply:
        try:
            command = frames.decode_command(request)
            if token != self.node.record.token:
                raise CommandRefused("the token is not that of the system that the component belongs to")
        except CommandRefused as error:
            return self._reply(request, error)
        if not isinstance(command, commands.PingCommand):
            await self._registered.wait()
        if command.kind != "changing":
            return await self._carry_out(request, command)
        if (answer := self._replies.get(request.id)) is None:
            answer = self._replies[request.id] = asyncio.get_running_loop().create_task(self._change(request, command))
            if len(self._replies) > _REMEMBERED:
                del self._replies[next(iter(self._replies))]
        return await asyncio.shield(answer)

    async def _change(self, request: Request, command: Command[Any]) -> Reply:
        async with self._lock:
            if request.revision != self.node.record.revision:
                words = f"the component is at revision {self.node.record.revision}, and the request expects "
                return self._reply(request, CommandRefused(f"{words}{request.revision}: observe it again, then retry"))
            return await self._carry_out(request, command)

    async def _carry_out(self, request: Request, command: Command[Any]) -> Reply:
        try:
            if isinstance(command, commands.WelcomeCommand):
                if self._failed is not None:
                    raise CommandRefused(self._failed)
                self._changed(welcomed=True)
                result: WireValue = self.node.state()
            elif isinstance(command, commands.ObserveCommand) and command.timeout:
                await self._graph_watch.look(command.timeout)
                result = self.node.state()
            else:
                result = await self._commands.carry_out(command)
                if command.kind == "changing":
                    self._changed()
        except MidstrideError as error:
            return self._reply(request, error)
        return Reply(id=request.id, revision=self.node.record.revision, result=frames.encode_value(result))

    def _reply(self, request: Request, refused: MidstrideError) -> Reply:
        return Reply(id=request.id, revision=self.node.record.revision, refused=str(refused))

    def _changed(self, **changes: Any) -> None:
        """The node has changed: in these fields of its record, and in its revision."""
        self.node.change_record(revision=self.node.record.revision + 1, **changes)
        self._report()

    def _report(self) -> None:
        self._reported = self.node.gate_states()
        self._server.report(frames.StateChanged(state=self.node.state()))
