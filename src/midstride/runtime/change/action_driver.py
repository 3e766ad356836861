"""Each action of the model, carried out on live components.

An action is done when every component concerned has acknowledged it. If it fails, its partial effects are undone on
each component that can be reached.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

from immutables import Map

from midstride.errors import CallTimeout, CommandRefused, MidstrideError, StepFailed, Unreachable
from midstride.model import wording
from midstride.model.action import (
    Action,
    Attach,
    Create,
    Degrade,
    Detach,
    Handover,
    Remove,
    SetParameters,
    Swap,
    Upgrade,
)
from midstride.model.component import PortRef
from midstride.model.configuration import Configuration, Instance
from midstride.model.specification import handover_seconds
from midstride.plan.state_continuity import left_behind, without_outputs
from midstride.runtime.backend_protocol import Backend
from midstride.runtime.change import answering_roles
from midstride.runtime.change.change_phases import ChangePhase
from midstride.runtime.change.handover_watch import watch_new_publishers
from midstride.runtime.change.managed_nodes import require_unmanaged_at_its_end
from midstride.runtime.change.mode_changes import ModeChanges
from midstride.runtime.change.parameter_settings import ParameterSettings
from midstride.runtime.change.running_change import RunningChange
from midstride.runtime.handover.cut_turns import CutTurn, only_turn
from midstride.runtime.handover.fences import Fences, StepBudget
from midstride.runtime.handover.live_handover import LiveHandover
from midstride.runtime.handover.new_publishers import ATTACH_TIMEOUT, DETACH_TIMEOUT
from midstride.runtime.handover.state_moves import StateMoves
from midstride.runtime.handover.state_transfers import (
    StateTransfers,
    has_left_state,
    import_state,
    keeps_state,
    own_state,
)
from midstride.runtime.instance_life import ProcessEvent
from midstride.runtime.process.answering_instance import have_answer
from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.process.launcher import Launcher
from midstride.runtime.process.reached_hosts import unreached
from midstride.runtime.records.events import EventLog
from midstride.runtime.records.reports import StateMove
from midstride.runtime.records.state_store import LeftState
from midstride.runtime.running_system import RunningSystem
from midstride.runtime.watch.observed_configuration import own_degradations_in
from midstride.wire import commands
from midstride.wire.commands import Command

R = TypeVar("R")


@dataclass(slots=True)
class ActionDriver:
    """Performs the actions of ``change`` on the components of ``system``, whose configuration is that before an action.

    While the change is rolled back, a removed instance gets back its own state, and a failure to transfer state does
    not fail the action. ``last_numbers`` holds the number of the last message of each output that was detached, and
    ``first_numbers`` that of the first message of each that took over at an agreed moment. States of replacements that
    hand over no output move as well. ``moved``: by new node without Midstride's API, the state that has moved to it.
    ``save`` is called with each role whose exported state is to be kept for the next manager, or, with None, no longer.
    """

    client: ComponentClient
    launcher: Launcher
    backend: Backend
    system: RunningSystem
    events: EventLog
    change: RunningChange
    save: Callable[[str, LeftState | None], object] = lambda role, state: None
    last_numbers: dict[PortRef, int | None] = field(default_factory=dict)
    first_numbers: dict[PortRef, int] = field(default_factory=dict)
    late: dict[str, float] = field(default_factory=dict)
    moved: dict[str, StateMove] = field(default_factory=dict)
    # By instance: what state of its predecessor it continues without, and why.
    own_state: dict[str, str] = field(default_factory=dict)
    # The instances that were ended although it was not seen last whether a lifecycle manager would notice.
    unseen: set[str] = field(default_factory=set)
    fences: Fences = field(init=False)
    modes: ModeChanges = field(init=False)
    settings: ParameterSettings = field(init=False)
    _moves: StateMoves = field(init=False)
    _inputs_ready: float = -math.inf  # when those are that were attached (steady s)
    _keeping: set[str] = field(default_factory=set)  # instances that keep state, also where they have exited since
    _crashed: dict[str, str] = field(default_factory=dict)  # by role: what kept state, and has exited before
    _left: frozenset[str] = frozenset()  # the roles of which an earlier manager has left exported state
    # Of a roll-back: the instances that should answer requests again, and do not, and why.
    _not_answering: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        change = self.change.plan.change
        self.system.life.begin_change()
        self.fences = Fences(self.client, self.launcher, self.events, self.change.patience)
        self.modes = ModeChanges(self.client, self.system)
        self.settings = ParameterSettings(self.client, self.system, self.events, self.change)
        self._moves = StateMoves(self.client, self._move_state, self._keeps_own_state, without_outputs(change))
        self._left = frozenset(self.system.exported)
        self._keeping = {name for name in change.replaced if keeps_state(self.client, name)}
        for name in self.system.life.missing:
            if (role := self.system.role_of_missing(name)) is not None and keeps_state(self.client, name):
                self._crashed[role] = name
        predecessors = {new: old for old, new in change.replaced.items()}
        for new, because in left_behind(change, self.change.actions).items():
            self._keeps_own_state(predecessors[new], new, because)

    @property
    def rolling_back(self) -> bool:
        return self.change.phase is ChangePhase.ROLLING_BACK

    @property
    def _state_timeout(self) -> float:
        """The time that state may take to move, to be exported or to be imported (s)."""
        return handover_seconds(self.change.target.timing, "state_timeout")

    @property
    def configuration(self) -> Configuration:
        return self.system.configuration

    async def perform(self, action: Action, because: str, turn: CutTurn | None = None) -> None:
        """Carry out ``action``, whose precondition holds. Raises MidstrideError.

        ``because`` is the reason that components report for their new modes; ``turn`` is that of a hand-over beside
        others.
        """
        budget = self.fences.budget(self._may_fence(action))
        if any(self.fences.hangs_already(name) for name in action.instances()):
            await self._fence_leaving(action, self.fences.now())
        try:
            await self._moves.before(action, self.configuration.instances)
            try:
                await self._perform(action, because, budget, turn)
            except (CommandRefused, CallTimeout):
                if not await self._fence_leaving(action, budget.until):
                    raise
                await self._perform(action, because, self.fences.budget(self._may_fence(action)))
        except (CommandRefused, StepFailed) as error:
            if degradations := await self._own_degradations(action):
                raise StepFailed("; ".join(degradations)) from error
            raise

    async def _fence_leaving(self, action: Action, deadline: float) -> bool:
        """Fence the instances of a step that the plan removes and that hang until ``deadline``; whether there are any.

        They need not do their part: what they still do in that call is neither heard nor relied on.
        """
        found = False
        for name in self._may_fence(action):
            modes = action.modes if isinstance(action, Degrade) else ()
            leaving = [ref.functionality for ref in modes if ref.instance == name]
            if (because := await self.fences.unresponsive(name, deadline, leaving)) is not None:
                found = True
                links = [(port, self.configuration.topic(key)) for port, key in self.configuration.attached_ports(name)]
                await self.fences.fence(
                    name, because, [link for link in links if self.configuration.is_output(link[0])]
                )
        return found

    def _may_fence(self, action: Action) -> list[str]:
        """The instances of a step that the plan removes, and that have not been fenced yet."""
        if self.rolling_back or not isinstance(action, Degrade | Detach | Remove):
            return []
        return sorted(self.change.leaving.intersection(action.instances()) - self.system.life.fenced.keys())

    async def _own_degradations(self, action: Action) -> list[str]:
        """Degradations in the instances of ``action`` that no command asked for: the root cause of whatever they
        refused.
        """
        found = []
        expected = action.modes if isinstance(action, Degrade) else {}
        for name in sorted(action.instances()):
            if self.system.life.responsive(name) is None:
                continue
            try:
                state = await self.client.peek(name)
            except MidstrideError:
                continue
            for ref in sorted(own_degradations_in(self.configuration, state).keys() - expected.keys()):
                view = state.functionalities[ref.functionality]
                found.append(f"{ref} entered mode {view.mode} unexpectedly: {view.because.strip()}")
        return found

    async def start(self, instance: Instance) -> bool:
        """Start the process of an instance that is to be created; see :meth:`Launcher.start`.

        What a roll-back brings back of programs that end is that they have.
        """
        if instance.component.once and self.rolling_back:
            return False
        # One that gets state first answers what it has held with that; agents in the manager's process do not wait so.
        imports = instance.component.has_agent and instance.role in self.system.exported
        standby, topics = imports or self.system.has_instance(instance.role), self._topics(instance)
        await self.change.parameters.ask(instance)
        start_values = self.change.parameters.start_values
        others = self._beside(instance)
        predecessor = others[0] if others and not self.system.life.is_gone(others[0]) else ""
        return await self.launcher.start(
            instance,
            standby=standby,
            start_values=start_values,
            topics=topics,
            predecessor=predecessor,
            returns=self.rolling_back,
        )

    def _beside(self, instance: Instance) -> list[str]:
        """The other instances of its role."""
        return [each.name for each in self.configuration.instances_of(instance.role) if each.name != instance.name]

    def _topics(self, instance: Instance) -> dict[str, str]:
        """The topic of each port of a component whose program has to know them when it starts."""
        if instance.component.gate is None:
            return {}
        change = self.change.plan.change
        comes = any(instance.name == each.name for each in change.coming)
        specification = change.target if comes else change.specification
        attachments = specification.attachments_of(instance.role) if instance.role in specification.nodes else []
        return {port.port: specification.connectors[connector].topic for port, connector in attachments}

    async def _perform(self, action: Action, because: str, budget: StepBudget, turn: CutTurn | None = None) -> None:
        if not isinstance(action, Attach):
            await self.await_inputs()
        match action:
            case Create(instance) if instance.component.once:
                if self.rolling_back:
                    self.system.life.record(instance.name, ProcessEvent.COMPLETED)
                else:
                    await self.launcher.completed(instance)
            case Remove(instance) if self.configuration.component(instance).once:
                self.system.life.record(instance, ProcessEvent.ENDED)
            case Create(instance):
                standby = self.system.has_instance(instance.role)
                await self.start(instance)
                await self.launcher.registered(instance)
                await self.change.parameters.started(instance)
                if (left := self.system.exported.get(instance.role)) is not None:
                    await self._import_state(instance, left)
                elif not self.rolling_back:
                    self._lost_in_crash(instance)
                if not standby:  # it may already, unless it waited for state, or was started by hand and replaced once
                    await have_answer(self.client, instance.name)
            case Degrade() | Upgrade():
                await self.modes.enter(action, because, budget)
            case Handover():
                await self._hand_over(action, turn)
            case SetParameters() if self.rolling_back:
                await self.settings.put_back(action)
            case SetParameters():
                await self.settings.put(action)
            # The others need no command where a process has exited, or where a port keeps its endpoint because it is
            # attached to another connector of the same topic.
            case Remove(instance) if not self.system.life.has_exited(instance):
                self._require_successor(instance)
                if not self.rolling_back:
                    component = self.configuration.component(instance)
                    if not await require_unmanaged_at_its_end(self.client, instance, component):
                        self.unseen.add(instance)
                await self._successor_answers(instance, runs=True)
                await self._remove(action, budget)
                await self._successor_answers(instance, runs=False)  # if it did not respond
            case Remove(instance):
                if instance in self._keeping and not self.rolling_back:
                    self._state_lost(instance, f"{instance} had exited")
                await self._successor_answers(instance, runs=False)
            case Attach(port, connector) if not self._has_endpoint(port, connector):
                await self._attach(action)
            case Detach(port, connector) if self._serves_on(port, connector):
                words = f"{port.instance} serves {connector} as long as it runs: replace it, or remove it"
                raise StepFailed(f"{port} cannot be taken off {connector}: {words}")
            case Detach(port, connector) if not (
                self.system.life.is_gone_or_fenced(port.instance) or self._has_endpoint(port, connector)
            ):
                await self._detach(action, budget)

    def _serves_on(self, port: PortRef, connector: str) -> bool:
        """Return whether it is a server that nothing but the end of its process takes out of the graph."""
        configuration = self.configuration
        if configuration.component(port.instance).gate is None:
            return False
        ends = self.rolling_back or port.instance in self.change.leaving or self.system.life.is_gone(port.instance)
        return answering_roles.serves(configuration, port, connector) and not ends

    def _require_successor(self, leaving: str) -> None:
        """Raises StepFailed if what replaces an instance without taking over a topic has exited already.

        Nothing else would show that the new program is broken, and the old one still works.
        """
        swaps = [swap for action in self.change.actions if isinstance(action, Handover) for swap in action.swaps]
        handed = {swap.new.instance for swap in swaps}
        started = self.system.configuration.instances  # an earlier one of that name may have exited long ago
        for old, new in () if self.rolling_back else self.change.plan.change.replaced.items():
            life = self.system.life[new]
            if old == leaving and new in started and new not in handed and life.exit is not None:
                words, log = (
                    f"{new}, which replaces {old}, {wording.exited(life.exit.status)}",
                    life.exit.log_tail.strip(),
                )
                raise StepFailed(wording.with_log(words, log) if log else words)

    async def _move_state(self, old: str, new: str) -> None:
        try:
            await self._live_handover((), [(old, new)])
        except MidstrideError as error:
            if not self.rolling_back:
                raise
            self._keeps_own_state(old, new, str(error))

    def _keeps_own_state(self, old: str, new: str, because: str) -> None:
        if old in self._keeping:
            self.own_state[new] = own_state(old, new, because)
            self.events.add("note", f"{new} keeps its own state: {because}")

    def _has_endpoint(self, port: PortRef, connector: str) -> bool:
        """Return whether another connector of the same topic has ``port``, as while a topic's contract changes.

        Components know topics, not connectors.
        """
        topic, others = self.configuration.topic(connector), self.configuration.attached_to(port)
        return any(other != connector and self.configuration.topic(other) == topic for other in others)

    async def _remove(self, action: Remove, budget: StepBudget) -> None:
        instance = self.configuration.instances[action.instance]
        fenced = action.instance in self.system.life.fenced
        # In a roll-back, this change created it, and the instance that returns has its own state.
        moved = self.change.plan.change.replaced.get(action.instance) in self.moved
        if not self.rolling_back and not fenced and not moved:
            longest = budget.timeout(action.instance, self._state_timeout)
            export = commands.ExportStateCommand(timeout=longest)
            try:
                exported = await self.client.read(action.instance, export)
                if exported.state is not None:
                    latest = self.system.life.latest(action.instance)
                    left = LeftState("" if latest is None else latest.state.uuid, exported.state)
                    self.system.exported[instance.role] = left
                    self._save_exported(instance, left)
                elif exported.lost is not None:
                    self._state_lost(action.instance, exported.lost)
            except (CallTimeout, Unreachable) as error:  # an unresponsive component must still be removable
                self._state_lost(action.instance, str(error))
        elif self.rolling_back and (kept := self.system.exported.get(instance.role)) is not None:
            self._save_exported(instance, kept)
        await self.change.parameters.leaving(action.instance, self.configuration)
        if instance.component.run is None:
            try:
                await self.launcher.release(action.instance)
            except MidstrideError as error:
                if not fenced:
                    raise
                self.launcher.leave(action.instance)
                self.events.add("note", f"{action.instance} could not be released: {error}; end its process")
            self.events.add("note", f"{action.instance} was started elsewhere: it is released, and left running")
        else:
            await self.launcher.end(action.instance, whole=self.change.plan.change.ends_process_of(instance))
        await self.change.parameters.leaving(action.instance, self.configuration)

    def _save_exported(self, leaving: Instance, left: LeftState) -> None:
        """Keep state for the next manager, unless an instance of the role runs beside: that has worked on with it."""
        if all(map(self.system.life.is_gone, self._beside(leaving))):
            self.save(leaving.role, left)

    def _lost_in_crash(self, coming: Instance) -> None:
        """Note that what comes again after a crash has not the state of the one that has exited."""
        if (name := self._crashed.get(coming.role)) is not None:
            because = f"{name} exited before it had exported its state"
            self.own_state[coming.name] = own_state(name, coming.name, because)
            self.events.add("note", f"{coming.name} starts with its own state: {because}")

    def _state_lost(self, leaving: str, because: str) -> None:
        """Note that an instance has ended without its state; also in the report, where its replacement is to come."""
        self.events.add("note", f"the state of {leaving} is lost: {because}")
        new = self.change.plan.change.replaced.get(leaving)
        if new is not None and new not in self.configuration.instances and leaving in self._keeping:
            self.own_state[new] = own_state(leaving, new, because)

    async def _successor_answers(self, leaving: str, runs: bool) -> None:
        failed = await answering_roles.have_others_answer(self.client, self.events, self.configuration, leaving, runs)
        if self.rolling_back:
            self._not_answering |= failed

    def _moving_states(self) -> dict[str, str]:
        """The instances whose state moves to that which replaces them, and that."""
        return {old: new for old, new in self.change.plan.change.replaced.items() if old in self._keeping}

    def not_answering(self) -> list[str]:
        """The reason why a roll-back is incomplete although each step is undone: what should answer again does not."""
        life = self.system.life
        latest = {name: life.latest(name) for name in self._not_answering if not life.is_gone(name)}
        return [self._not_answering[name] for name, each in latest.items() if each is None or not each.state.answers]

    async def _import_state(self, instance: Instance, left: LeftState) -> None:
        lenient = self.rolling_back or instance.role in self._left
        found = await import_state(self.client, instance, left, self._state_timeout, lenient=lenient)
        if found is not None:
            self.events.add("note", found)
            if not self.rolling_back:
                self.own_state[instance.name] = f"{found}; lost is the state that the last {instance.role} had exported"
        elif instance.role in self._left:
            self.events.add("note", has_left_state(instance))
        self.save(instance.role, None)

    def forget_exported(self) -> None:
        """The change has ended: forget the state that was exported. What an earlier manager left waits for its role."""
        for role in list(self.system.exported):
            waits = role in self._left and role in self.system.specification.nodes
            if not waits or self.system.has_instance(role):
                del self.system.exported[role]
                self.save(role, None)

    async def _attach(self, action: Attach) -> None:
        port, topic, configuration = action.port, self.configuration.topic(action.connector), self.configuration
        output = configuration.is_output(port)
        if not configuration.is_topic(action.connector):  # which have no messages that somebody must be there for
            attach = commands.AttachCommand(
                port=port.port, topic=topic, peers=0, timeout=ATTACH_TIMEOUT, await_ready=False
            )
            detach = commands.DetachCommand(port=port.port, topic=topic, timeout=DETACH_TIMEOUT)
            await self._or_undo(port.instance, attach, detach)
            if output:
                moving = {} if self.rolling_back else self._moving_states()
                await answering_roles.have_first_answer(self.client, self.events, configuration, port.instance, moving)
            return
        others = (configuration.subscribers_on if output else configuration.publishers_on)(action.connector)
        # A subscriber that cannot be reached may be found later; what a publisher is needed for would not arrive.
        lost = unreached(self.backend) if output else {}
        hosts = ((other, configuration.instances[other.instance].host) for other in others)
        peers = sum(not self.system.life.is_gone(other.instance) and host not in lost for other, host in hosts)
        attach = commands.AttachCommand(
            port=port.port, topic=topic, peers=peers, timeout=ATTACH_TIMEOUT, await_ready=False, **self._relied_on(port)
        )
        detach = commands.DetachCommand(port=port.port, topic=topic, timeout=DETACH_TIMEOUT)
        reply = await self._or_undo(port.instance, attach, detach)
        self._inputs_ready = max(self._inputs_ready, self.backend.clock.steady() + reply.ready_in)

    async def await_inputs(self) -> None:
        """Wait until all inputs that were attached are ready: those of many attachments in a row do so together."""
        clock = self.backend.clock
        if self._inputs_ready > clock.steady():
            await clock.sleep(self._inputs_ready - clock.steady())

    async def _detach(self, action: Detach, budget: StepBudget) -> None:
        port, topic = action.port, self.configuration.topic(action.connector)
        timeout = budget.timeout(port.instance, DETACH_TIMEOUT)
        detach = commands.DetachCommand(port=port.port, topic=topic, timeout=timeout)
        attach = commands.AttachCommand(port=port.port, topic=topic, timeout=DETACH_TIMEOUT, **self._relied_on(port))
        reply = await self._or_undo(port.instance, detach, attach)
        if reply.last:
            self.last_numbers[port] = reply.last
        topical = self.configuration.is_topic(action.connector)
        if reply.acknowledged is None and self.configuration.is_output(port) and topical:
            self.events.add("note", f"{port}: unknown whether its last messages on {topic} arrived")

    def _relied_on(self, port: PortRef) -> dict[str, Any]:
        """The bounds that the specification states for an input; none for an output."""
        component = self.configuration.component(port.instance)
        assumption = component.inputs.get(port.port)
        if assumption is None:
            return {}
        stated = {"condition": port.port in component.conditions}
        if assumption.rate is None:
            return stated
        return {**stated, "rate": assumption.rate, "tolerates": component.tolerates.get(port.port)}

    async def _or_undo(self, instance: str, command: Command[R], undo: Command[Any]) -> R:
        """The reply to ``command``; if it fails, send ``undo`` in case it was partly carried out."""
        try:
            return await self.client.change(instance, command)
        except Exception:
            await self.client.undo(instance, undo)
            raise

    async def _hand_over(self, action: Handover, turn: CutTurn | None) -> None:
        configuration = self.configuration
        pairs = {(swap.old.instance, swap.new.instance) for swap in action.swaps}
        roles = {name: instance.role for name, instance in configuration.instances.items()}
        await self.change.before_handover(configuration, action)
        # Where the outputs of other roles are swapped, nothing is replaced.
        replaced = [(old, new) for old, new in pairs if old != new and roles[old] == roles[new]]
        await self._live_handover(action.swaps, replaced, turn)

    async def _live_handover(
        self, swaps: Sequence[Swap], replaced: Collection[tuple[str, str]], turn: CutTurn | None = None
    ) -> None:
        """Hand over what is swapped, and the state of ``replaced``, pairs of old and new."""
        self._keeping.update(old for old, _ in replaced if keeps_state(self.client, old))
        states = StateTransfers(
            self.client,
            self.events,
            replaced,
            not self.rolling_back,
            self._state_timeout,
            keeping=self._keeping,
            own_state=self.own_state,
        )
        handover = LiveHandover(
            self.client,
            self.events,
            self.configuration,
            swaps,
            self.backend,
            states,
            self.fences,
            self._carry_parameters,
            Map() if self.rolling_back else self.change.target.timing,
            turn or only_turn(),
            rates=not self.rolling_back and not (self.change.brief and "probation" not in self.change.target.timing),
        )
        self.last_numbers |= await handover.run()
        self.first_numbers |= handover.first_numbers
        self.late |= states.late
        self.moved |= states.moved

    async def watch(self, action: Action) -> None:
        """After a hand-over, watch the new publishers; see :func:`watch_new_publishers`. Raises StepFailed."""
        if not isinstance(action, Handover):
            return
        try:
            await watch_new_publishers(self.client, self.events, self.change, self.configuration, action)
        except StepFailed as error:
            if degradations := await self._own_degradations(action):
                raise StepFailed("; ".join(degradations)) from error
            raise

    async def _carry_parameters(self, old: str, new: str) -> None:
        if not self.rolling_back:
            await self.change.parameters.before_cut(old, self.configuration.instances[new])
