"""The end of a component's process, in order and in bounded time. Control thread."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from midstride.errors import BackendError, CommandRefused
from midstride.model.component import CANCELLING
from midstride.model.wording import LOST_AT_END
from midstride.node.author.declaration import DeclaredParts
from midstride.node.component_host import HeldParameter, Host
from midstride.node.control.attachments import Attachments
from midstride.node.control.mode_commands import ModeCommands
from midstride.node.data.functionality_runner import CAUGHT, FunctionalityRunner, format_error
from midstride.node.data.mode_switch import DataExecutor
from midstride.node.handover.handover_commands import HandoverCommands
from midstride.node.legible import legible

# How long ending takes besides the author's `on_stop` (s): destroying endpoints and leaving the platform.
SHUTDOWN_SECONDS: Final = 1.0
# How long a request to a service that is being handled may take, once its instance is to end (s). For so long, at most,
# it also stays for clients that have not discovered its successor.
REQUESTS_SECONDS: Final = 10.0
# Such a client is waited for where a request has been answered within so long (s): one that calls once a second may be
# one. The middleware does not say whom a client has discovered; ROS's own finds a new server within 3 s.
CALLED_WITHIN: Final = 1.5
# How long a server stays in ROS after its last response (s): a client whose middleware learns that the server has left
# before it has read the response drops it, and the middleware does not say when a response has arrived.
RESPONSE_SECONDS: Final = 0.5


@dataclass
class ComponentEnd:
    """The steps by which a component ends, so that what others have asked of it is done, or said to be lost.

    ``declared`` returns every parameter, those of the ROS node as well; ``patience``: how long its goals may take (s).
    """

    parts: DeclaredParts
    host: Host
    runners: Sequence[FunctionalityRunner]
    data: DataExecutor
    modes: ModeCommands
    attachments: Attachments
    handovers: HandoverCommands
    declared: Callable[[], Mapping[str, HeldParameter]]
    patience: float
    # In which way the author's `on_stop` has failed, and what it has left of its goals.
    unfinished: str | None = None

    async def run(self) -> None:
        """Finish requests, stop calls, run the author's `on_stop`, destroy endpoints; each in bounded time."""
        deadline = self.host.steady() + int(REQUESTS_SECONDS * 1e9)
        await self._finish_requests(deadline)
        await self._finish_goals()
        self.handovers.close_cuts()
        self.modes.take_hold()  # no call is begun any more
        timeout = self.parts.callbacks.stop_timeout
        try:
            await self.data.run(self._stop_calls, timeout)
            await self._idle(timeout)
        except CommandRefused as error:
            self.host.logger.error(f"{self.host.instance} ends, but {error}")
        if self.parts.callbacks.stop is not None:
            try:
                if not await self.data.drive(self.parts.callbacks.stop, timeout):
                    self._left_unfinished(f"on_stop did not return within {timeout:.3g} s: {LOST_AT_END}")
            except CAUGHT as error:
                words = legible(f"on_stop raised {type(error).__name__}: {error}").partition("\n")[0]
                self._left_unfinished(f"{words}: {LOST_AT_END}")
                self.host.logger.error(f"on_stop raised: {format_error(error)}")
        with contextlib.suppress(CommandRefused, BackendError):
            await self.attachments.close_all(0.5)
        deadline = max(deadline, self.host.steady() + int(RESPONSE_SECONDS * 1e9))
        while self.host.admission.answered_within(RESPONSE_SECONDS) and self.host.steady() < deadline:
            await self.host.sleep(0.01)
        self.handovers.close()

    async def _finish_requests(self, deadline: int) -> None:
        """Answer the requests to services that are being handled, and begin with no other. ``deadline``: steady ns.

        What only this instance has received of those held now, its successor handles first. A client that has called
        lately may not have discovered that successor: without this instance, which passes its requests on, its next one
        would reach no server.
        """
        admission, answering = self.host.admission, self.handovers.answering
        admission.pause()
        held = set(answering.undecided())
        while admission.busy or held.intersection(answering.undecided()) or self._may_pass_on:
            if self.host.steady() >= deadline:
                if admission.busy:
                    words = f"a request to a service of it was not answered within {REQUESTS_SECONDS:g} s"
                elif held.intersection(answering.undecided()):
                    words = f"after {REQUESTS_SECONDS:g} s, its successor has not said which of the requests held here "
                    words += "it has received"
                else:
                    words = f"after {REQUESTS_SECONDS:g} s, a client still sends its requests to it alone"
                self.host.logger.error(f"{self.host.instance} ends, but {words}")
                return
            await self.host.sleep(0.01)

    @property
    def _may_pass_on(self) -> bool:
        """True where another instance answers instead, and a client that called lately may not have discovered it."""
        return self.handovers.answering.may_pass_on and self.host.admission.answered_within(CALLED_WITHIN)

    async def _finish_goals(self) -> None:
        """If a successor takes new goals, finish its own goals, then leave their results to the successor.

        What has not ended after the patience is cancelled.
        """
        goals, answering = self.host.admission.goals, self.handovers.answering
        if not answering.has_successor:
            return
        patience, begun = self.patience, self.host.steady()
        if not await self._goals_end(patience):
            seconds = (self.host.steady() - begun) / 1e9
            words = f"{_goals(goals.in_progress)} had not ended after {seconds:.0f} s (`patience`)"
            goals.cancel()
            if not await self._goals_end(CANCELLING):
                words += f", and {_goals(goals.in_progress)} {CANCELLING:g} s after cancelling was asked for"
            else:
                words += ", and cancelling was asked for"
            self._left_unfinished(words)
        if (lost := await answering.hand_over_results()) is not None:
            self._left_unfinished(lost)
        if goals.counts is not None:
            await self.host.sleep(RESPONSE_SECONDS)

    async def _goals_end(self, seconds: float) -> bool:
        """Wait until no goal is in progress, for ``seconds`` at most; whether that is so."""
        deadline = self.host.steady() + int(seconds * 1e9)
        while in_progress := self.host.admission.goals.in_progress:
            if self.host.steady() >= deadline:
                return False
            await self.host.sleep(0.01)
        return not in_progress

    def _left_unfinished(self, words: str) -> None:
        self.host.logger.error(f"{self.host.instance} ends, but {words}")
        self.unfinished = words if self.unfinished is None else f"{self.unfinished}; {words}"

    @property
    def _goes_on_with_goals(self) -> bool:
        return self.host.admission.goals.has_any and self.handovers.answering.has_successor

    def _stop_calls(self) -> None:
        for parameter in self.declared().values():
            parameter.closed = "the component is ending"
        for runner in self.runners:
            runner.stop_calls()

    async def _idle(self, timeout: float) -> None:
        """Wait until no async call runs. Raises CommandRefused after ``timeout``."""
        deadline = self.host.steady() + int(timeout * 1e9)
        while any(runner.asynchronous for runner in self.runners):
            if self.host.steady() >= deadline:
                raise CommandRefused(f"user code did not return within {timeout:.3g} s{self.data.busy()}")
            await self.host.sleep(0.01)

    def seconds(self) -> float:
        """The time that :meth:`run` takes where user code keeps to its times.

        That of a request that is being handled, or may have to be passed on, of the call under way, and of `on_stop`.
        """
        callbacks = self.parts.callbacks
        waits = self.host.admission.busy or self._may_pass_on or self.handovers.answering.undecided()
        requests = REQUESTS_SECONDS if waits else 0.0
        requests += self.patience + 2 * CANCELLING + RESPONSE_SECONDS if self._goes_on_with_goals else 0.0
        requests += RESPONSE_SECONDS if requests or self.host.admission.answered_within(RESPONSE_SECONDS) else 0.0
        return requests + callbacks.stop_timeout * (1 if callbacks.stop is None else 2) + SHUTDOWN_SECONDS


def _goals(number: int) -> str:
    return f"{number} goal{'s' * (number != 1)}"
