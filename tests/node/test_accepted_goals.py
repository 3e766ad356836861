"""Goals of ROS actions across a replacement: whose turn it is with what is asked about them, and what outlasts them."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from functools import partial
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from midstride.backends.simulator.virtual_loop import run
from midstride.errors import CallTimeout, Unreachable
from midstride.node import accepted_goals
from midstride.node.accepted_goals import Goals
from midstride.node.control.service_answering import FOLLOW_INTERVAL, PASS_INTERVAL, RESULTS_ATTEMPTS, Answering
from midstride.node.request_admission import HOLD, GoalTurn, RequestAdmission
from midstride.wire.commands import (
    AnswerCommand,
    CancelledGoalsCommand,
    Command,
    KeepResultsCommand,
    MissingRequestsCommand,
    PingCommand,
    YieldCommand,
)
from midstride.wire.frames import Reply, encode_value
from midstride.wire.replies import Done
from midstride.wire.state import GoalCounts


class Instance:
    """An instance of a role with a server of a ROS action, on the loop's clock. All of a role can reach each other.

    ``answers``: what each request has been answered with: which instance has the goal, or what it has kept of it.
    """

    def __init__(self, name: str, role: dict[str, Instance], *, is_open: bool) -> None:
        self.name = name
        self.answers: dict[str, list[str]] = {}
        self.is_gone = False
        self.late = 0  # so many calls are carried out, and their replies come too late
        self.changes = 0
        self._role = role
        self._tasks: set[asyncio.Task[None]] = set()
        self._waiting: dict[str, list[str]] = {}  # by goal, the requests for its result
        role[name] = self
        clock = asyncio.get_running_loop().time
        self.admission = RequestAdmission(lambda: int(clock() * 1e9), is_open=is_open)
        self.answering = Answering(
            self.admission, self.call, self._changed, self._start, asyncio.sleep, lambda: self.name
        )

    def _changed(self) -> None:
        self.changes += 1

    def receives_goal(self, goal: str) -> None:
        accept = partial(self._accept, goal)
        if self.admission.admit(f"goal {goal}", accept, asks_for=goal):
            accept()

    def _accept(self, goal: str) -> None:
        self.admission.goals.accepted(goal, lambda: self.ends(goal, cancelled=True))
        self.admission.finished(f"goal {goal}")

    def ends(self, goal: str, *, cancelled: bool = False) -> None:
        result = f"{'cancelled' if cancelled else 'result'} by {self.name}"
        self.admission.goals.ended(goal, result.encode, cancelled=cancelled)
        for request in self._waiting.pop(goal, []):
            self._answer(request, result)

    def asks(self, request: str, goal: str) -> None:
        """Receive the request for the result of ``goal``."""
        if self.admission.goal_turn(request, goal, partial(self.asks, request, goal)) is not GoalTurn.ANSWER:
            return
        goals = self.admission.goals
        if goal not in goals._own:
            kept = goals.kept(goal)
            goals.fetched(goal)
            self._answer(request, "unknown" if kept is None else kept.decode())
        else:
            goals.fetched(goal)
            found = goals._own[goal]
            if found.result is None:
                self._waiting.setdefault(goal, []).append(request)
            else:
                self._answer(request, found.result().decode())
        self.admission.finished(request)

    def cancels_all(self, request: str) -> None:
        """Receive a request to cancel all goals; what is cancelled is listed, not done."""
        turn, goals = self.admission.goal_turn(request, "", partial(self.cancels_all, request)), self.admission.goals
        if turn is GoalTurn.ADD:
            goals.add_list(request, self.name.encode())
        elif turn is GoalTurn.ANSWER and self.admission.predecessor_has_goals:
            goals.await_list(request, lambda added: self._answer(request, f"{self.name} and {(added or b'').decode()}"))
        elif turn is GoalTurn.ANSWER:
            self._answer(request, self.name)
        self.admission.finished(request)

    def _answer(self, request: str, what: str) -> None:
        self.answers.setdefault(request, []).append(what)

    async def call(self, address: str, command: Command[Any], timeout: float) -> Reply:
        other = self._role[address]
        if other.is_gone:
            raise Unreachable("it has exited")
        handlers: dict[type[Command[Any]], Callable[[Any], Awaitable[Any]]] = {
            YieldCommand: other.answering.stop,
            MissingRequestsCommand: other.answering.missing,
            CancelledGoalsCommand: other.answering.cancelled_goals,
            KeepResultsCommand: other.answering.keep_results,
            PingCommand: other._pong,
        }
        found = await handlers[type(command)](command)
        if other.late:
            other.late -= 1
            raise CallTimeout("it has not answered")
        return Reply(id="1", revision=1, result=encode_value(found))

    async def _pong(self, command: PingCommand) -> Done:
        return Done()

    async def replaces(self, old: Instance) -> None:
        await self.answering.answer(AnswerCommand(peer=old.name, address=old.name))

    async def finishes(self) -> str | None:
        """End as its process does once its goals have ended; which results are lost, in words."""
        lost = await self.answering.hand_over_results()
        self.is_gone = True
        return lost

    def _start(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.ensure_future(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)


def with_two(scenario: Callable[[Instance, Instance], Coroutine[Any, Any, None]]) -> None:
    async def main() -> None:
        role: dict[str, Instance] = {}
        await scenario(Instance("old", role, is_open=True), Instance("new", role, is_open=False))

    run(main())


def test_what_a_predecessor_has_left_is_answered_where_it_is_kept_and_then_left_again() -> None:
    """Three instances, one after the other: of two results, one is fetched of the second while the third answers."""

    async def main() -> None:
        role: dict[str, Instance] = {}
        first, second = Instance("first", role, is_open=True), Instance("second", role, is_open=False)
        for goal in ("fetched", "left"):
            first.receives_goal(goal)
            first.ends(goal)
        await second.replaces(first)
        assert await first.finishes() is None
        third = Instance("third", role, is_open=False)
        await third.replaces(second)
        for each in (second, third):
            each.asks("1", "fetched")
        assert (second.answers, third.answers) == ({"1": ["result by first"]}, {})
        assert await second.finishes() is None
        third.asks("2", "left")
        assert third.answers == {"2": ["result by first"]}

    run(main())


ORDERS = st.sampled_from(["old new", "new old", "new"])


@given(st.lists(st.tuples(st.integers(0, 4), ORDERS, st.booleans()), max_size=25), st.data())
def test_each_request_about_a_goal_is_answered_once_by_the_instance_that_has_it(
    asked: list[tuple[int, str, bool]], data: st.DataObject
) -> None:
    """Goals 0 to 2 are the old instance's, 3 the new one's, 4 of none; both receive each request, in either order.

    Some reach the new one alone: of the old one's goals, that answers once the old one has ended.
    """
    change = data.draw(st.integers(0, len(asked)))

    async def scenario(old: Instance, new: Instance) -> None:
        def ask(number: int, goal: int, order: str) -> None:
            for name in order.split():
                (old if name == "old" else new).asks(f"result {number}", str(goal))

        for goal in "012":
            old.receives_goal(goal)
            new.receives_goal(goal)
        old.ends("0")
        for number, (about, order, _) in enumerate(asked[:change]):
            ask(number, about if about != 3 else 4, order)
        await new.replaces(old)
        for each in (old, new):
            each.receives_goal("3")
        for number, (about, order, ends) in enumerate(asked[change:], change):
            if ends and about == 1 and old.admission.goals.in_progress == 2:
                old.ends("1")
            ask(number, about, order)
        for goal in ("1", "2"):
            if old.admission.goals._own[goal].result is None:
                old.ends(goal)
        new.ends("3")
        await old.finishes()
        await asyncio.sleep(2 * FOLLOW_INTERVAL)
        new.asks("late", "2")
        answered = dict(old.answers)
        for name, found in new.answers.items():
            answered[name] = answered.get(name, []) + found
        late = answered.pop("late")
        fetched = {about for about, order, _ in asked if order != "new"}
        assert late == (["unknown"] if 2 in fetched else ["result by old"])
        expected = {0: "result by old", 1: "result by old", 2: "result by old", 3: "result by new", 4: "unknown"}

        def answer(number: int, about: int, order: str) -> str:
            not_kept = about < 3 and order == "new" and about in fetched
            return "unknown" if not_kept or (number < change and about == 3) else expected[about]

        assert answered == {
            f"result {number}": [answer(number, about, order)] for number, (about, order, _) in enumerate(asked)
        }

    with_two(scenario)


def test_what_a_predecessor_was_asked_about_a_goal_that_has_not_ended_is_answered_by_its_successor() -> None:
    """Its patience is over: the client learns that the goal is not known any more, instead of waiting for ever."""

    async def scenario(old: Instance, new: Instance) -> None:
        old.receives_goal("1")
        await new.replaces(old)
        for each in (old, new):
            each.asks("1", "1")
        await old.finishes()
        assert (old.answers, new.answers) == ({}, {"1": ["unknown"]})

    with_two(scenario)


def test_goals_of_a_predecessor_that_dies_are_not_known_any_more() -> None:
    async def scenario(old: Instance, new: Instance) -> None:
        old.receives_goal("1")
        await new.replaces(old)
        new.asks("early", "1")
        assert new.answers == {}
        old.is_gone = True
        await asyncio.sleep(2 * FOLLOW_INTERVAL)
        new.asks("late", "1")
        assert new.answers == {"early": ["unknown"], "late": ["unknown"]}

    with_two(scenario)


def test_a_request_to_cancel_all_goals_gets_one_response_with_both_lists() -> None:
    async def scenario(old: Instance, new: Instance) -> None:
        old.receives_goal("1")
        await new.replaces(old)
        for each in (old, new):
            each.cancels_all("all")
        new.cancels_all("other")
        old.cancels_all("other")
        await asyncio.sleep(2 * PASS_INTERVAL)
        assert (old.answers, new.answers) == ({}, {"all": ["new and old"], "other": ["new and old"]})
        old.ends("1")
        assert not await old.finishes()
        new.cancels_all("late")
        assert new.answers["late"] == ["new"]

    with_two(scenario)


def test_two_clients_whose_requests_to_cancel_all_goals_look_the_same_get_a_response_each() -> None:
    async def scenario(old: Instance, new: Instance) -> None:
        old.receives_goal("1")
        await new.replaces(old)
        for each in (old, new, new, old):
            each.cancels_all("all")
        await asyncio.sleep(2 * PASS_INTERVAL)
        assert (old.answers, new.answers) == ({}, {"all": ["new and old"] * 2})

    with_two(scenario)


@pytest.mark.parametrize("first", ["list", "request"])
def test_lists_for_requests_that_look_the_same_are_taken_in_order(first: str) -> None:
    goals, found = Goals(), list[tuple[int, bytes | None]]()

    def take(number: int, added: bytes | None) -> None:
        found.append((number, added))

    for number in range(2):
        if first == "request":
            goals.await_list("1", partial(take, number))
        else:
            goals.list_arrived("1", bytes([number]))
    for number in range(2):
        if first == "request":
            goals.list_arrived("1", bytes([number]))
        else:
            goals.await_list("1", partial(take, number))
    assert found == [(0, b"\0"), (1, b"\1")]


def test_a_list_that_does_not_come_is_not_waited_for_for_long(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(accepted_goals, "ADDING", 0.0)
    goals, found = Goals(), list[bytes | None]()
    goals.await_list("1", found.append)
    deadline = asyncio.new_event_loop()
    try:
        deadline.run_until_complete(_until(lambda: bool(found)))
    finally:
        deadline.close()
    assert found == [None]
    goals.list_arrived("1", b"late")
    goals.await_list("1", found.append)
    assert found == [None, b"late"]


async def _until(condition: Callable[[], bool]) -> None:
    while not condition():
        await asyncio.sleep(0.001)


def test_results_outlast_several_instances_up_to_a_size(monkeypatch: pytest.MonkeyPatch) -> None:
    async def main() -> None:
        role: dict[str, Instance] = {}
        first, second, third = (Instance(name, role, is_open=name == "1") for name in "123")
        first.receives_goal("a")
        first.ends("a")
        await second.replaces(first)
        assert not await first.finishes()
        second.receives_goal("b")
        second.ends("b")
        await third.replaces(second)
        monkeypatch.setattr(accepted_goals, "KEPT_RESULTS", len("result by 1"))
        assert not await second.finishes()
        third.asks("1", "a")
        third.asks("2", "b")
        assert third.answers == {"1": ["unknown"], "2": ["result by 2"]}, "the oldest is given up"

    run(main())


def test_results_that_a_successor_does_not_take_are_counted() -> None:
    async def scenario(old: Instance, new: Instance) -> None:
        for goal in "12":
            old.receives_goal(goal)
            old.ends(goal)
        assert await old.answering.hand_over_results() is None, "nothing is handed over where there is no successor"
        old.admission.goals._handed_over = False
        await new.replaces(old)
        old.asks("1", "1")
        new.is_gone = True
        because = "its successor has not taken them: it has exited"
        assert await old.finishes() == f"1 result that no client had fetched is lost, as {because}"

    with_two(scenario)


@pytest.mark.parametrize("late", [1, RESULTS_ATTEMPTS])
def test_results_whose_receipt_is_confirmed_too_late_are_not_said_to_be_lost(late: int) -> None:
    async def scenario(old: Instance, new: Instance) -> None:
        old.receives_goal("1")
        old.ends("1")
        await new.replaces(old)
        new.late = late
        words = "it is not known whether its successor has 1 result that no client had fetched: it has not responded"
        assert await old.finishes() == (None if late < RESULTS_ATTEMPTS else words)
        new.asks("1", "1")
        assert new.answers == {"1": ["result by old"]}

    with_two(scenario)


def test_an_instance_whose_state_has_moved_reports_that_its_goals_need_time() -> None:
    async def scenario(old: Instance, new: Instance) -> None:
        old.receives_goal("1")
        assert old.answering.pause()
        before = old.changes
        old.answering.state_moved(new.name)
        assert (old.changes, old.answering.has_successor) == (before + 1, True)

    with_two(scenario)


def test_a_goal_that_is_just_being_accepted_stays_with_the_old_instance() -> None:
    admission = RequestAdmission(lambda: 0)
    assert admission.admit("goal 1", lambda: None, asks_for="1")
    admission.close()
    assert admission.give_goals() == ["1"]
    assert admission.goal_turn("cancel 1", "1", lambda: None) is GoalTurn.ANSWER
    assert admission.goals.accepted("1", lambda: None), "it is in progress here, although it was given before"
    assert admission.goals.in_progress == 1
    assert not admission.goals.accepted("1", lambda: None), "the same UUID once more"
    assert admission.goals.counts == GoalCounts(accepted=1)


def test_what_ros_has_discarded_is_still_answered_for_where_the_successor_leaves_it() -> None:
    admission = RequestAdmission(lambda: 0)
    admission.goals.accepted("1", lambda: None)
    admission.goals.ended("1", bytes, cancelled=False)
    admission.close()
    assert admission.give_goals() == ["1"]
    admission.goals.expired("1")
    assert admission.goal_turn("result 1", "1", lambda: None) is GoalTurn.ANSWER
    assert admission.goals.hand_over() == {}
    assert admission.goal_turn("result 1", "1", lambda: None) is GoalTurn.WAIT


def test_the_results_of_a_server_that_has_left_the_graph_are_answered_by_the_next_one() -> None:
    """Results that a client has, and those of another server of the instance, are not kept."""
    goals, one, other = RequestAdmission(lambda: 0).goals, lambda: None, lambda: None
    for goal, cancel_all in (("left", one), ("fetched", one), ("other", other), ("goes on", one)):
        assert goals.accepted(goal, cancel_all)
        if goal != "goes on":
            goals.ended(goal, f"result of {goal}".encode, cancelled=False)
    goals.fetched("fetched")
    goals.server_left(one)
    assert [goals.kept(goal) for goal in ("left", "fetched", "other", "goes on")] == [
        b"result of left",
        None,
        None,
        None,
    ]
    assert (goals.has("left"), goals.has("other"), goals.in_progress) == (False, True, 1)
    assert goals.counts == GoalCounts(accepted=4, ended=3)
    goals.fetched("left")
    assert goals.hand_over() == {"other": b"result of other"}


def test_requests_of_two_clients_about_goals_may_look_the_same() -> None:
    """The identity of a client is not in what rclpy passes: each of these is answered."""
    admission = RequestAdmission(lambda: 0)
    assert [admission.goal_turn("cancel all 1", "", lambda: None) for _ in range(2)] == [GoalTurn.ANSWER] * 2


def test_a_request_that_looks_like_another_clients_handled_before_is_handled_all_the_same() -> None:
    """The predecessor has handled the first request of one client, and the new instance holds that of another one."""

    def handled(by_old: list[float], by_new: list[float]) -> int:
        """How many of those that come to the new instance at these times (s) it handles."""
        time, called = 0.0, list[float]()
        old = RequestAdmission(lambda: int(time * 1e9))
        new = RequestAdmission(lambda: int(time * 1e9), is_open=False)
        for time in sorted({*by_old, *by_new}):
            if time in by_old:
                assert old.goal_turn("cancel all 1", "", lambda: None) is GoalTurn.ANSWER
            if time in by_new:
                assert new.goal_turn("cancel all 1", "", partial(called.append, time)) is GoalTurn.WAIT
        time = max(*by_old, *by_new) + 0.1
        new.open(old.close())
        return len(called)

    assert handled([1.0], [1.0]) == handled([1.0], [1.3]) == 0, "the same request at both"
    assert handled([1.0], [40.0]) == 1, "that of another client, long after"
    assert handled([1.0], [1.0, 1.2]) == 2, "which of the two was handled is not known"
    assert handled([1.0, 1.2], [1.01, 1.21]) == 0
    assert handled([1.0, 30.0], [30.1]) == 0


def test_what_waits_while_state_moves_is_asked_again_once_it_has() -> None:
    called: list[str] = []
    admission = RequestAdmission(lambda: 0)
    admission.goals.accepted("1", lambda: None)
    admission.pause()
    assert admission.goal_turn("cancel 1", "1", lambda: None) is GoalTurn.ANSWER, "the goal does not move"
    assert admission.goal_turn("cancel all", "", lambda: called.append("all")) is GoalTurn.WAIT
    admission.leave()
    assert called == ["all"]
    assert admission.goal_turn("cancel all", "", lambda: None) is GoalTurn.ADD


def test_what_is_held_about_goals_is_dropped_after_a_while() -> None:
    time = 0.0
    called: list[str] = []
    admission = RequestAdmission(lambda: int(time * 1e9), is_open=False)
    assert admission.goal_turn("result 1", "1", lambda: called.append("1")) is GoalTurn.WAIT
    time = HOLD + 1
    admission.open([])
    assert called == []


def test_goals_are_counted_by_what_has_become_of_them() -> None:
    assert Goals().counts is None
    goals, cancelled = Goals(), list[str]()
    for goal in "123":
        goals.accepted(goal, lambda: cancelled.append("all"))
    goals.ended("1", bytes, cancelled=False)
    goals.ended("2", bytes, cancelled=True)
    goals.not_known()
    assert goals.counts == GoalCounts(accepted=3, ended=1, cancelled=1, unknown=1)
    goals.cancel()
    assert goals.in_progress == 1 and len(cancelled) == 1
