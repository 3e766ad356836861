"""Faults planted in Midstride's own code: each is a mistake that a change of the code could make."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from typing import Any, Final

import pytest

from midstride.errors import CallTimeout
from midstride.model.action import Create, Remove
from midstride.node.accepted_goals import Goals
from midstride.node.author import client_ports
from midstride.node.author.client_ports import ClientPort
from midstride.node.author.ports import OutputLink
from midstride.node.control import component_agent
from midstride.node.control.component_end import ComponentEnd
from midstride.node.control.service_answering import Answering
from midstride.node.control.shortfall import Shortfall
from midstride.node.handover import cut, cut_protocol, lease
from midstride.node.request_admission import GoalTurn, RequestAdmission
from midstride.runtime.change import action_driver, executor, reconciler, roll_back
from midstride.runtime.handover import live_handover
from midstride.runtime.hosts import host_link
from midstride.runtime.hosts.call_forms import ExitedForm
from midstride.runtime.instance_life import LifeTable
from midstride.runtime.process import component_client, launcher
from midstride.runtime.records import state_store
from midstride.runtime.records.disk import Database
from midstride.runtime.restore import recovery
from midstride.runtime.restore.fallback_leases import FallbackLeases
from midstride.wire import commands, replies
from midstride.wire.clock_offset import ClockOffset
from tests.planting import plant, plant_value

Plant = Callable[[pytest.MonkeyPatch], None]


def _acknowledgement_dropped(patch: pytest.MonkeyPatch) -> None:
    """The old side of a cut forgets that the new one has reported its first write."""

    async def taken(self: Any, failed: bool, place: str = "") -> bool:
        return False

    plant(patch, cut_protocol.CutOutTask, "taken", taken)


def _resumed_without_lock(patch: pytest.MonkeyPatch) -> None:
    """The old side of a cut writes again although the new one may have taken over: its report is late."""
    plant(patch, cut_protocol.CutOutTask, "_may_resume", lambda self: not self._taken)


def _written_without_lock(patch: pytest.MonkeyPatch) -> None:
    """The new side of a cut writes although the old one may write again."""
    plant(patch, cut.IncomingCut, "admits", cut.IncomingCut.passes)


def _lease_not_checked(patch: pytest.MonkeyPatch) -> None:
    """The new side of a cut between two hosts writes on although its lease is over."""
    plant(patch, lease.NewLease, "_may_write", lambda self: self._confirmed or self._until > 0)


def _write_not_durable(patch: pytest.MonkeyPatch) -> None:
    """A write returns before it is durable: it is committed with the next one, as without an fsync."""
    write = Database.write

    def later(self: Any, statements: Any, *args: Any, **named: Any) -> None:
        held = self.__dict__.pop("held", [])
        self.held = list(statements)
        write(self, held, *args, **named)

    plant(patch, Database, "write", later)


def _dependants_not_lowered(patch: pytest.MonkeyPatch) -> None:
    """After a crash, no dependent functionality is degraded."""
    respond = reconciler.respond
    plant(patch, reconciler, "respond", lambda *args, **named: (respond(*args, **named)[0], {}))


def _gate_opened_early(patch: pytest.MonkeyPatch) -> None:
    """The new publisher's gate opens as soon as the cut is agreed."""
    plant(patch, cut.IncomingCut, "passes", lambda self, link: True)


def _gate_closed_late(patch: pytest.MonkeyPatch) -> None:
    """The old publisher goes on after the agreed moment."""
    plant(patch, cut.OutgoingCut, "passes", lambda self, link: True)

    def passed(self: Any) -> bool:
        self.over = self.now() >= self.at
        return bool(self.over)

    plant(patch, cut.OutgoingCut, "passed", passed)


def _steps_swapped(patch: pytest.MonkeyPatch) -> None:
    """A removed component is ended before its last attachment is taken off: two steps have changed places."""

    def without_check(self: Any, configuration: Any) -> Any:
        return configuration.without_instance(self.instance)

    run = executor.Executor.run

    async def swapped(self: Any, overlap: Any = None) -> None:
        actions = self.change.actions
        removes = [index for index, action in enumerate(actions) if isinstance(action, Remove) and index]
        for index in removes[-1:]:
            actions[index - 1], actions[index] = actions[index], actions[index - 1]
        await run(self)

    plant(patch, Remove, "apply", without_check)
    plant(patch, executor.Executor, "run", swapped)


def _start_not_recorded(patch: pytest.MonkeyPatch) -> None:
    """The process of a new instance is not recorded for the next manager."""
    write = state_store.StateStore.write_instance

    def only_known(self: Any, instance: Any, handle: Any, *, done: bool = False) -> None:
        if "_" not in instance.name:
            write(self, instance, handle, done=done)

    plant(patch, state_store.StateStore, "write_instance", only_known)


def _roll_back_not_recorded(patch: pytest.MonkeyPatch) -> None:
    """An instance that a roll-back starts again is not recorded (the simulation has found this one)."""

    async def undo(self: Any, undoing: Any, created: Any, failed: Any) -> str | None:
        if isinstance(undoing, Create):
            await self.performer.perform(undoing)
            return None
        return await original(self, undoing, created, failed)

    original = roll_back.RollBack._undo
    plant(patch, roll_back.RollBack, "_undo", undo)


def _removal_not_recorded(patch: pytest.MonkeyPatch) -> None:
    """A removed instance stays recorded."""
    plant(patch, state_store.StateStore, "remove_instance", lambda self, name: None)


def _specification_not_saved(patch: pytest.MonkeyPatch) -> None:
    """After a change, the earlier specification stays saved."""
    plant(patch, state_store.StateStore, "write_specification", lambda self, specification: None)


def _failed_write_forgotten(patch: pytest.MonkeyPatch) -> None:
    """What could not be written while the disk was full is not written later."""
    write = state_store.StateStore._write

    def forgetting(self: Any, statements: Any) -> None:
        write(self, statements)
        self._pending.clear()

    plant(patch, state_store.StateStore, "_write", forgetting)


def _undo_incomplete(patch: pytest.MonkeyPatch) -> None:
    """A roll-back leaves out the first step."""
    back = roll_back.RollBack.run

    async def all_but_one(self: Any, done: Any, failed: Any = ()) -> list[str]:
        return await back(self, done[1:], failed)

    plant(patch, roll_back.RollBack, "run", all_but_one)


def _started_ahead_left(patch: pytest.MonkeyPatch) -> None:
    """What was started for steps that are not reached is left running."""

    async def abandon(self: Any, actions: Any) -> list[str]:
        return []

    plant(patch, roll_back.RollBack, "abandon", abandon)


def _lease_forgotten(patch: pytest.MonkeyPatch) -> None:
    """A manager goes on to write after another one has taken over."""
    write = Database.write
    plant(patch, Database, "write", lambda self, statements, only_if=None: write(self, statements))


def _superseded_goes_on(patch: pytest.MonkeyPatch) -> None:
    """A superseded manager begins no further step, and goes on to change components otherwise."""
    plant_value(patch, component_client.ComponentClient, "superseded", lambda: lambda: False)


def _saved_by_superseded(patch: pytest.MonkeyPatch) -> None:
    """A superseded manager goes on to save the state of the system."""

    def write(self: Any, statements: Any) -> None:
        self._lease.renew()
        original(self, statements)

    original = state_store.StateStore._write
    plant(patch, state_store.StateStore, "_write", write)


def _orphans_left(patch: pytest.MonkeyPatch) -> None:
    """A new manager does not look for processes that the one before could not record."""

    async def end_orphans(self: Any, known: Any) -> list[str]:
        return []

    plant(patch, launcher.Launcher, "end_orphans", end_orphans)


def _redundant_left(patch: pytest.MonkeyPatch) -> None:
    """A new manager keeps both instances of a role that was being replaced."""
    plant(patch, recovery, "_redundant", lambda found: [])


def _cut_not_cancelled(patch: pytest.MonkeyPatch) -> None:
    """A hand-over that fails leaves its cut agreed at both sides."""

    async def cancel(self: Any, cuts: Any) -> None:
        pass

    plant(patch, live_handover.LiveHandover, "_cancel", cancel)


def _handover_not_undone(patch: pytest.MonkeyPatch) -> None:
    """A hand-over that fails leaves the new publisher attached behind its gate."""

    async def undo(self: Any) -> None:
        await self._cancel(self._cuts)

    plant(patch, live_handover.LiveHandover, "_undo", undo)


def _servers_taken_off(patch: pytest.MonkeyPatch) -> None:
    """A hand-over that tries again takes its new servers off their services (found on real ROS 2)."""
    undo = live_handover.LiveHandover._undo_exchange

    async def too_much(self: Any) -> None:
        await undo(self)
        for swap in self._services:
            detach = commands.DetachCommand(port=swap.new.port, topic=self._topic(swap))
            await self.client.undo(swap.new.instance, detach)

    plant(patch, live_handover.LiveHandover, "_undo_exchange", too_much)


def _never_resumes(patch: pytest.MonkeyPatch) -> None:
    """The old side of a cut waits for the new one for ever."""
    plant(patch, cut_protocol.CutOutTask, "_given_up", lambda self: False)


def _repetition_carried_out(patch: pytest.MonkeyPatch) -> None:
    """A repeated request is carried out again, at whatever revision."""

    async def change(self: Any, request: Any, command: Any, token: str) -> Any:
        return await self._carry_out(request, command, token)

    plant(patch, component_agent.Agent, "_change_once", change)


def _pending_forgotten(patch: pytest.MonkeyPatch) -> None:
    """A functionality that could not be degraded is not tried again."""
    plant_value(patch, reconciler.Reconciler, "pending", dict)


def _lost_reply_not_repeated(patch: pytest.MonkeyPatch) -> None:
    """A request whose reply is lost is taken for done."""
    send = component_client.ComponentClient._send

    async def trusting(self: Any, instance: str, command: Any, revision: Any) -> Any:
        if isinstance(command, commands.DetachCommand):
            with contextlib.suppress(CallTimeout):
                return await send(self, instance, command, revision)
            return replies.Detached(acknowledged=None, last=None)
        return await send(self, instance, command, revision)

    plant(patch, component_client.ComponentClient, "_send", trusting)


def _gate_not_reopened(patch: pytest.MonkeyPatch) -> None:
    """The old side of a cut that is given up leaves its gate closed."""
    plant(patch, cut.OutgoingCut, "reopen", lambda self: setattr(self, "over", True))


def _new_side_not_closed(patch: pytest.MonkeyPatch) -> None:
    """The new side of a cut that the old one has given up leaves its gate open."""
    plant(patch, cut.IncomingCut, "close", cut.IncomingCut.conclude)


def _both_answer(patch: pytest.MonkeyPatch) -> None:
    """An instance that is asked to stop goes on to answer requests."""
    close = RequestAdmission.close

    def still_open(self: Any) -> list[str]:
        handled = close(self)
        self.open(())
        return handled

    plant(patch, RequestAdmission, "close", still_open)


def _handled_forgotten(patch: pytest.MonkeyPatch) -> None:
    """The old instance does not say which requests it has handled."""
    close = RequestAdmission.close

    def forgetting(self: Any) -> list[str]:
        close(self)
        return []

    plant(patch, RequestAdmission, "close", forgetting)


def _held_dropped(patch: pytest.MonkeyPatch) -> None:
    """The new instance drops the requests that it has held."""
    opened = RequestAdmission.open
    plant(patch, RequestAdmission, "open", lambda self, handled, goals=(): opened(self, None, goals))


def _answered_again(patch: pytest.MonkeyPatch) -> None:
    """A request that was answered is answered again."""
    answer = RequestAdmission._answer

    def twice(self: Any, request: str, result: Any, respond: Any) -> None:
        answer(self, request, result, respond)
        respond(result)

    plant(patch, RequestAdmission, "_answer", twice)


def _unanswered_not_ended(patch: pytest.MonkeyPatch) -> None:
    """A client that gives a request up lets its caller wait."""
    plant(patch, ClientPort, "_end_calls", lambda self, late=None: None)


def _server_believed_there(patch: pytest.MonkeyPatch) -> None:
    """A client does not notice that its server has left."""
    patch.setattr(client_ports, "ABSENT", math.inf)


def _goals_not_left(patch: pytest.MonkeyPatch) -> None:
    """The new instance answers what is asked about the goals of the old one."""
    opened = RequestAdmission.open
    plant(patch, RequestAdmission, "open", lambda self, handled, goals=(): opened(self, handled))


def _results_not_left(patch: pytest.MonkeyPatch) -> None:
    """The old instance does not leave the results that no client has fetched."""

    async def hand_over_results(self: Any) -> None:
        self.admission.goals.hand_over()

    plant(patch, Answering, "hand_over_results", hand_over_results)


def _goals_not_awaited(patch: pytest.MonkeyPatch) -> None:
    """The old instance ends before its goals have."""

    async def goals_end(self: Any, seconds: float) -> bool:
        return True

    plant(patch, ComponentEnd, "_goals_end", goals_end)


def _results_not_looked_for(patch: pytest.MonkeyPatch) -> None:
    """The new instance does not look for what the old one has left."""
    plant(patch, Goals, "kept", lambda self, goal: None)


def _cancelled_by_the_wrong_one(patch: pytest.MonkeyPatch) -> None:
    """The instance that answers goes ahead with a request to cancel a goal of the other one."""
    turn = RequestAdmission.goal_turn

    def whoever(self: Any, request: str, about: str, later: Any) -> GoalTurn:
        return GoalTurn.ANSWER if request.startswith("cancel") and self.is_open else turn(self, request, about, later)

    plant(patch, RequestAdmission, "goal_turn", whoever)


def _lost_start_left(patch: pytest.MonkeyPatch) -> None:
    """A link that is back leaves what may have been started as it broke, so that the node runs twice."""

    async def end_lost(self: Any) -> None:
        self._lost.clear()

    plant(patch, host_link.HostLink, "_end_lost", end_lost)


def _exits_repeated(patch: pytest.MonkeyPatch) -> None:
    """A link that is back reports the exits of earlier managers' processes (the simulation has found this one)."""
    greet = host_link.HostLink._greet

    async def forgetful(self: Any, connection: Any, reader: Any, writer: Any) -> None:
        before = self._uuid
        await greet(self, connection, reader, writer)
        if self._uuid != before:
            self._seen = 0

    plant(patch, host_link.HostLink, "_greet", forgetful)


def _unreachable_taken_for_crashed(patch: pytest.MonkeyPatch) -> None:
    """What runs on a host that cannot be reached counts as crashed."""
    fail_calls = host_link.HostLink._fail_calls

    def crashed(self: Any) -> None:
        fail_calls(self)
        for name in list(self.handles):
            self._exited(ExitedForm(instance=name))

    plant(patch, host_link.HostLink, "_fail_calls", crashed)


def _left_on_host(patch: pytest.MonkeyPatch) -> None:
    """What could not be ended while its host was out of reach is left (the simulation has found this one)."""
    plant(patch, LifeTable, "left_on_hosts", lambda self, instances: [])


def _link_of_superseded(patch: pytest.MonkeyPatch) -> None:
    """A superseded manager goes on to connect to its hosts (the simulation has found this one)."""
    patch.setattr(
        host_link.HostLink, "_superseded", property(lambda self: lambda: False, lambda self, _: None), raising=False
    )


def _fallback_lease_not_checked(patch: pytest.MonkeyPatch) -> None:
    """A component with a fallback on another host writes on although its lease is over."""
    plant(patch, OutputLink, "_publish_leased", lambda self, message: self.endpoint.publish(message))


def _fallback_lease_not_awaited(patch: pytest.MonkeyPatch) -> None:
    """The fallback takes over as soon as the host cannot be reached."""
    give_up = FallbackLeases._give_up
    plant(patch, FallbackLeases, "_give_up", lambda self, lost, now: give_up(self, lost, now + 1e9))


def _state_set_back(patch: pytest.MonkeyPatch) -> None:
    """The next manager gives an instance that has taken over the state which the one before had as it was removed."""
    plant(
        patch, action_driver.ActionDriver, "_save_exported", lambda self, leaving, left: self.save(leaving.role, left)
    )


def _silence_not_noticed(patch: pytest.MonkeyPatch) -> None:
    """A component does not notice that an input with a rate is silent."""
    plant(patch, Shortfall, "exceeds", lambda self, periods, slow=True: False)


def _offset_of_the_wrong_sign(patch: pytest.MonkeyPatch) -> None:
    """The offset between the clocks of two hosts is taken the wrong way round."""
    between = ClockOffset.between

    def wrong(self: Any, third: Any) -> ClockOffset:
        return between(third, self)

    plant(patch, ClockOffset, "between", wrong)


# Each with words of the violation by which it is found.
PLANTED: Final[dict[str, tuple[Plant, str]]] = {
    function.__name__.strip("_").replace("_", " "): (function, words)
    for function, words in (
        (_acknowledgement_dropped, "resumed before it learned"),
        (_resumed_without_lock, "are both heard on"),
        (_written_without_lock, " both "),
        (_lease_not_checked, "are both heard on"),
        (_offset_of_the_wrong_sign, "without faults"),
        (_lost_start_left, "without faults"),
        (_exits_repeated, "is said to have exited, and runs"),
        (_unreachable_taken_for_crashed, "is said to have exited, and runs"),
        (_left_on_host, "without faults"),
        (_link_of_superseded, "a superseded manager has connected"),
        (_fallback_lease_not_checked, " both "),
        (_fallback_lease_not_awaited, " both "),
        (_state_set_back, "is set back to the state of"),
        (_silence_not_noticed, "has not arrived for more than"),
        (_write_not_durable, "another manager of this system has taken over"),
        (_lease_forgotten, "a superseded manager starts"),
        (_superseded_goes_on, "a superseded manager sends"),
        (_saved_by_superseded, "although what it assumes there is broken, and the manager does not react"),
        (_dependants_not_lowered, "although what it assumes there is broken, and the manager does not react"),
        (_gate_opened_early, "is set back to the state of"),
        (_gate_closed_late, "both write one slot"),
        (_steps_swapped, "without faults"),
        (_start_not_recorded, "run, and are not saved"),
        (_roll_back_not_recorded, "run, and are not saved"),
        (_removal_not_recorded, "saved are"),
        (_specification_not_saved, "another specification is saved"),
        (_failed_write_forgotten, "another specification is saved"),
        (_undo_incomplete, "without faults"),
        (_started_ahead_left, "without faults"),
        (_orphans_left, "is open on"),
        (_redundant_left, " both "),
        (_cut_not_cancelled, "although nothing has failed"),
        (_handover_not_undone, "after the hand-over has failed"),
        (_servers_taken_off, "after the hand-over is done"),
        (_never_resumes, "although its publishers were alive"),
        (_repetition_carried_out, "and repeated at"),
        (_pending_forgotten, "the running system is not valid"),
        (_lost_reply_not_repeated, "after `detach` is done"),
        (_gate_not_reopened, "without faults"),
        (_new_side_not_closed, "is open on"),
        (_both_answer, "both answer requests"),
        (_handled_forgotten, "is executed by"),
        (_held_dropped, "is not executed, although"),
        (_answered_again, "is answered 2 times"),
        (_unanswered_not_ended, "and does not know that there is none"),
        (_server_believed_there, "has had no server for more than"),
        (_goals_not_left, "is answered by"),
        (_results_not_left, "is not known"),
        (_goals_not_awaited, "has ended, and a goal of"),
        (_results_not_looked_for, "is not known"),
        (_cancelled_by_the_wrong_one, "the cancelling of a goal"),
    )
}

# The built-in system on which these are found; the others on whichever a seed draws.
SYSTEMS: Final = {
    "cut not cancelled": "spread",
    "fallback lease not checked": "leased",
    "fallback lease not awaited": "leased",
    "servers taken off": "docking",
}


@contextlib.contextmanager
def planted(name: str) -> Iterator[str]:
    """While open, that fault is in the code; words of the violation by which it is found."""
    plant_it, words = PLANTED[name]
    with pytest.MonkeyPatch.context() as patch:
        plant_it(patch)
        yield words
