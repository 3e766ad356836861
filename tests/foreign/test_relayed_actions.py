"""Goals of a program behind a relay: accepted, executed and cancelled as the program does it, and what ends with it."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest

from midstride.foreign.relayed_actions import CANCELED, SUCCEEDED, RelayedActionServer

ABORTED = 6


class Result:
    pass


class Fibonacci:
    __actiontype__ = "demo/action/Fibonacci"
    Goal = object
    Result = Result
    Feedback = str


class Goal:
    """As rclpy's handle of a goal, at the relay."""

    def __init__(self, request: Any) -> None:
        self.request = request
        self.is_cancel_requested = False
        self.ended = ""
        self.heard: list[str] = []

    def publish_feedback(self, feedback: str) -> None:
        self.heard.append(feedback)

    def succeed(self) -> None:
        self.ended = "succeeded"

    def abort(self) -> None:
        self.ended = "aborted"

    def canceled(self) -> None:
        assert self.is_cancel_requested, "rclpy refuses it"
        self.ended = "canceled"


class Program:
    """A client of a program that accepts goals, unless they are ``no``; ``at``: how a goal ends; ``feedback`` hears."""

    def __init__(self) -> None:
        self.response: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        self.result: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        self.cancelled: list[Any] = ["the goal"]
        self.hear: Any = None
        host: Any = SimpleNamespace(
            steady=lambda: int(asyncio.get_running_loop().time() * 1e9),
            pause=asyncio.sleep,
            create_action_client=lambda *_: self,
        )
        self.server = RelayedActionServer("count", Fibonacci, "/_midstride/relay/talker/count", 0.5)
        self.server.connect(host)
        self.server.port.serving = True

    def call(self, request: Any, feedback: Any) -> asyncio.Future[Any]:
        self.hear = feedback
        handle = SimpleNamespace(
            accepted=request != "no", get_result_async=lambda: self.result, cancel_goal_async=self._cancel
        )
        self.response.set_result(handle)
        return self.response

    def _cancel(self) -> asyncio.Future[Any]:
        done: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        done.set_result(SimpleNamespace(goals_canceling=self.cancelled))
        return done

    def abandon(self, future: asyncio.Future[Any], error: Exception) -> None:
        future.set_exception(error)

    def says(self, feedback: str) -> None:
        self.hear(SimpleNamespace(feedback=feedback))

    def ends(self, status: int) -> None:
        self.result.set_result(SimpleNamespace(status=status, result=f"ended with {status}"))


@pytest.mark.parametrize(("status", "ended"), [(SUCCEEDED, "succeeded"), (ABORTED, "aborted")])
def test_a_goal_ends_as_the_program_ends_it(status: int, ended: str) -> None:
    async def scenario() -> None:
        program = Program()
        assert await program.server.port.accepts("count to 10")
        program.says("early")
        goal = Goal("count to 10")
        executed = asyncio.ensure_future(program.server.port.execute(goal))
        await asyncio.sleep(0)
        program.says("1")
        program.ends(status)
        assert await executed == f"ended with {status}"
        assert (goal.ended, goal.heard) == (ended, ["early", "1"])

    asyncio.run(scenario())


def test_a_goal_that_the_program_rejects_is_rejected() -> None:
    async def scenario() -> None:
        program = Program()
        assert not await program.server.port.accepts("no")
        program = Program()
        program.server.port.serving = False
        assert not await program.server.port.accepts("yes") and program.hear is None

    asyncio.run(scenario())


@pytest.mark.parametrize("known", [True, False], ids=["the result comes later", "the result comes first"])
def test_a_goal_is_cancelled_where_the_program_does_so(known: bool) -> None:
    async def scenario() -> None:
        program, goal = Program(), Goal("count to 10")
        assert await program.server.port.accepts(goal.request)
        executed = asyncio.ensure_future(program.server.port.execute(goal))
        assert await program.server.port.cancels(goal)
        goal.is_cancel_requested = known  # by rclpy, once the answer is known
        program.ends(CANCELED)
        await asyncio.sleep(0.02)
        goal.is_cancel_requested = True
        assert await executed == f"ended with {CANCELED}" and goal.ended == "canceled"
        assert not await program.server.port.cancels(goal), "it has ended"

        program, goal = Program(), Goal("another")
        program.cancelled = []
        assert await program.server.port.accepts(goal.request)
        assert not await program.server.port.cancels(goal), "the program has refused"

    asyncio.run(scenario())


def test_the_goals_of_a_program_that_has_exited_are_aborted() -> None:
    async def scenario() -> None:
        program, goal = Program(), Goal("count to 10")
        assert await program.server.port.accepts(goal.request)
        executed = asyncio.ensure_future(program.server.port.execute(goal))
        await asyncio.sleep(0)
        program.server.give_up()
        assert isinstance(await executed, Result) and goal.ended == "aborted"
        assert not await program.server.port.accepts("another")

    asyncio.run(scenario())
