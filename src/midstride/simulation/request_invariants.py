"""The invariants of every request to a service or ROS action, whatever strikes: checked where it passes.

Each request is executed at most once, by one instance, while no other one of its role answers, and answered at most
once. What reaches an instance that answers is executed, unless another one may have done that, and has died, as far as
the instance can know: which requests an instance of its role has received that had ended before it could be asked, it
does not. And where its client states a bound, it is answered, or its client knows in time that it is not.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

from midstride.backends.simulator.service_network import ServiceObserver, SimulatedRequest
from midstride.backends.simulator.simulated_process import SimulatedProcess
from midstride.node.author.client_ports import OVERDUE
from midstride.node.control.shortfall import LONG_FLOOR
from midstride.node.request_admission import HOLD
from midstride.simulation.goal_invariants import GoalInvariants
from midstride.simulation.platform import Platform
from midstride.simulation.stand_in import StandIn

# How much later than its time a client may notice that a request is not answered (s): where nothing else is due, the
# reflex looks every 0.5 s, and only looks again whether the data thread was free.
NOTICED: Final = 1.5


@dataclass
class RequestInvariants(ServiceObserver):
    """Watches the requests of ``platform``. ``heard`` is counted up with every response.

    Set with each seed are ``violated``, which is called with words, and ``torn()``: whether a fault may have kept the
    two sides of a change-over from reaching each other, where the one takes the other for dead.
    """

    platform: Platform
    heard: dict[str, int]
    violated: Callable[[str], None] = lambda words: None
    torn: Callable[[], bool] = lambda: False
    _exited: dict[int, StandIn] = field(default_factory=dict)  # by process id

    def __post_init__(self) -> None:
        self.goals = GoalInvariants(self.platform)

    def on_sent(self, request: SimulatedRequest) -> None:
        self.goals.on_sent(request)
        if (limit := self._limit(request)) < math.inf:
            self.platform.time.loop.call_later(limit, self._check_answered, request)

    def _limit(self, request: SimulatedRequest) -> float:
        """The time that its client may wait (s); infinite without a bound, or for the result of a goal."""
        process = request.client.owner
        assert isinstance(process, StandIn)
        bound = process.bound_of(request.client.name) if request.kind in ("request", "goal") else None
        return math.inf if bound is None else bound + OVERDUE + NOTICED

    def _check_answered(self, request: SimulatedRequest) -> None:
        process, now = request.client.owner, self.platform.time.steady()
        if request.identity not in self.platform.network.services.waiting or process.dead:
            return
        # What a call that hangs keeps waiting is not missing; a process that was stopped judges nothing for a while.
        since = max(request.since, process.reacts_since, process.frozen_until and process.frozen_until + LONG_FLOOR)
        left = since + self._limit(request) - now
        if left > 0:
            self.platform.time.loop.call_later(left, self._check_answered, request)
            return
        words = f"{process.instance} waits for a response of {request.client.name} for {now - request.since:.1f} s"
        self.violated(f"{words}, and does not know that there is none")

    def on_received(self, request: SimulatedRequest, process: SimulatedProcess) -> None:
        if request.kind == "request" and request.client.owner is not process:
            request.received.append(process)
            if len(request.received) == 1:
                self.platform.time.loop.call_later(HOLD + NOTICED, self._check_executed, request)

    def _check_executed(self, request: SimulatedRequest) -> None:
        """Check that an answering instance executes what it has received, unless another may have, which died."""
        for process in () if request.executed or self.torn() else request.received:
            assert isinstance(process, StandIn)
            began = process.answers_since
            others = [each for each in request.received if isinstance(each, StandIn) and each is not process]
            if not process.answers or began is None or began > request.since + HOLD:
                continue
            if process.reacts_since > request.since or any(each.exited_at < began for each in others):
                continue
            if self._had_no_one_to_ask(process, request, began):
                continue
            self.violated(f"a request to {request.client.name} is not executed, although {process.instance} has got it")

    def _had_no_one_to_ask(self, process: StandIn, request: SimulatedRequest, began: float) -> bool:
        """Return whether what ``process`` held is dropped by docs/protocols/services.md: it may have been handled.

        That is so where an instance of its role had exited when it began to answer, lately.
        """
        gone = (each for each in self._exited.values() if each.role == process.role and each is not process)
        return request.since < began and any(request.since - HOLD < each.exited_at <= began for each in gone)

    def on_exit(self, process: StandIn) -> None:
        """Note that a process has ended."""
        self._exited[process.pid] = process
        self.goals.on_exit(process)

    def on_executed(self, request: SimulatedRequest, process: SimulatedProcess) -> None:
        """Check that one instance executes it, once; or, where it is about a goal, the one that has that."""
        assert isinstance(process, StandIn)
        if request.kind in ("result", "cancel"):
            self.goals.on_executed(request, process)
            return
        request.executed.append(process)
        if len(request.executed) > 1 and not self.torn():
            names = " and ".join(each.instance for each in request.executed)
            self.violated(f"a request to {request.client.name} is executed by {names}")
        for other in self.platform.stand_ins():
            if other is not process and other.role == process.role and other.answers and not self.torn():
                names = " and ".join(sorted((process.instance, other.instance)))
                self.violated(f"{names} both answer requests to {request.client.name}")

    def on_ended(self, goal: str, process: SimulatedProcess, response: Any) -> None:
        self.goals.on_ended(goal, response)

    def on_response(self, request: SimulatedRequest, process: SimulatedProcess, response: Any) -> None:
        assert isinstance(process, StandIn)
        self.goals.on_response(request, process, response)
        self.heard[f"{process.instance} responds"] = self.heard.get(f"{process.instance} responds", 0) + 1
        # A successor does not know which requests to cancel goals an instance has answered that has ended since: rather
        # twice than not at all.
        again = self.torn() or request.kind == "cancel" or self.goals.may_answer_again(request)
        if request.responses > 1 and not again:
            what = "a request" if request.kind == "request" else f"a request ({request.kind})"
            self.violated(f"{what} to {request.client.name} is answered {request.responses} times")
