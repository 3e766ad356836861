"""The commands that decide which instance of a role answers requests to the node's services.

The successor asks its predecessor, directly, to stop, and with its reply begins to answer. So they do not need the
manager once it has sent the command, and there is no moment at which both answer. Where state moves, the predecessor
stops before it exports, and what it has handled comes with the state (:mod:`midstride.node.handover.state_transfer`).
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import dataclass, field
from typing import Any, Final

from midstride.errors import BackendError, CallTimeout, CommandRefused, MidstrideError, Unreachable
from midstride.model.wording import counted
from midstride.node.request_admission import HOLD, PASS_AFTER, PassableRequest, RequestAdmission
from midstride.node.shared_requests import RequestsSlot
from midstride.wire import commands, replies
from midstride.wire.channel import result_of
from midstride.wire.commands import Command
from midstride.wire.frames import Reply

# How long one attempt to have the predecessor stop may take (s), and how many there are.
YIELD_TIMEOUT: Final = 0.5
YIELD_ATTEMPTS: Final = 3
# How often a predecessor looks for requests that only it has received (s), and how long it waits for what the successor
# has to say about them.
PASS_INTERVAL: Final = 0.1
MISSING_TIMEOUT: Final = 0.5
# How often it is looked which of two nodes answers that share their requests (s).
SHARE_INTERVAL: Final = 0.02
# How long the response to a request that was passed on may take (s).
SERVE_TIMEOUT: Final = 10.0
# How often a successor looks whether the predecessor, which answers for its goals, still runs (s).
FOLLOW_INTERVAL: Final = 0.5
# How long one attempt to hand over the results of goals may take (s), which are 16 MiB at most, and how many there are.
RESULTS_TIMEOUT: Final = 1.0
RESULTS_ATTEMPTS: Final = 3


@dataclass
class Answering:
    """``call`` sends a command to a peer at an address; ``changed`` is called when a peer has had it stop. ``start``
    runs a coroutine in the background, ``sleep`` sleeps on the steady clock (s). ``own_address`` is where it is itself.
    """

    admission: RequestAdmission
    call: Callable[[str, Command[Any], float], Awaitable[Reply]]
    changed: Callable[[], None]
    start: Callable[[Coroutine[Any, Any, None]], object]
    sleep: Callable[[float], Awaitable[None]]
    own_address: Callable[[], str]
    instance: str = ""
    # The address of the instance that answers instead; None while none does.
    _successor: str | None = field(default=None, init=False)
    # Where the requests are shared with a node without the API.
    _page: RequestsSlot | None = field(default=None, init=False)

    async def answer(self, command: commands.AnswerCommand) -> replies.Answers:
        if not self.admission.is_open:
            if self._page is not None:
                return await self._answer_instead(self._page, command.drain)
            asked, own = command.address, command.own_address
            found = None if asked is None else await self._yielded(command.peer, asked, own)
            if found is not None and found.place is not None:
                return await self._answer_instead(self._join(found.place), command.drain)
            if found is not None:
                self._open(found.handled, found.goals, command.address or "")
            else:  # where this one is paused, no other one has begun
                self.admission.open(() if self.admission.is_paused else None)
        return replies.Answers()

    # -- requests that a node without the API shares ------------------------------------------------

    async def join(self, command: commands.JoinRequestsCommand) -> replies.Done:
        """A successor without the API is to answer: claim each request from now on, until it does."""
        self._join(command.place)
        return replies.Done()

    def _join(self, place: replies.PagePlace) -> RequestsSlot:
        if self._page is not None and self._page.place == place:
            return self._page
        self._leave()
        self._page = page = RequestsSlot(place)
        page.serve(set(self.admission.passed_handlers))
        self.admission.share(page)
        self.start(self._share(page))
        return page

    def _leave(self) -> None:
        if self._page is not None:
            page, self._page = self._page, None
            self.admission.share_no_longer()
            page.leave()

    async def _share(self, page: RequestsSlot) -> None:
        """Until the other one has been gone for so long that nothing arrives that it may have claimed."""
        alone = 0.0
        while self._page is page:
            page.serve(set(self.admission.passed_handlers))
            if self.admission.look():
                self.changed()
            alone = alone + SHARE_INTERVAL if page.is_alone else 0.0
            if alone >= HOLD:  # now, as another one may come at any time
                self._leave()
                return
            await self.sleep(SHARE_INTERVAL)

    async def _answer_instead(self, page: RequestsSlot, drain: float) -> replies.Answers:
        """Answer once the other one has answered what it has taken, or ``drain`` (s) is over."""
        page.answer(drain)
        waited = 0.0
        while not page.answers() and waited < drain:
            await self.sleep(SHARE_INTERVAL)
            waited += SHARE_INTERVAL
        left = page.left_before
        self.admission.look()
        return replies.Answers(outlasting=left)

    def _open(self, handled: list[str], goals: list[str], address: str) -> None:
        """Answer from now on. The instance at ``address``, the predecessor, goes on with these ``goals``."""
        self.admission.open(handled, goals)
        if goals:
            self.start(self._follow(address))

    def pause(self) -> bool:
        """Answer no request for now: the state is about to be exported. Whether this one answered until now."""
        self._leave()
        was_open = self.admission.pause()
        if was_open:
            self.changed()
        return was_open

    def take_over(self, found: replies.FetchedState | None, address: str, yields: int) -> None:
        """Answer from now on, since the state of the predecessor has arrived, unless it has asked for that again.

        ``found``: with what it has handled, and its goals; None: it has exited. ``address``: where it is. ``yields``:
        those of the admission when the transfer began.
        """
        if self.admission.yields == yields and not self.admission.is_open:
            if found is None or found.requests is None:
                self.admission.open(None)
            else:
                self._open(found.requests, found.goals, address)
            self.changed()

    async def take_back(self, peer: str, address: str, own_address: str = "") -> None:
        """Answer again, since the state has not moved after all: ``peer``, the new side, may have begun to answer.

        It may once it has reported that it has the state, or has asked this one to stop; either ends the pause.
        """
        if self.admission.is_paused:
            self.admission.open(())
        else:
            with contextlib.suppress(CommandRefused):  # it answers until the manager has ended it
                await self.answer(commands.AnswerCommand(peer=peer, address=address, own_address=own_address))
        self.changed()

    async def _yielded(self, peer: str, address: str, own_address: str) -> replies.Yielded | None:
        """Ask which requests the predecessor has handled; None if it has exited.

        Raises CommandRefused if it may still answer.
        """
        stop = commands.YieldCommand(address=own_address or self.own_address(), instance=self.instance)
        for _ in range(YIELD_ATTEMPTS):
            try:
                return result_of(await self.call(address, stop, YIELD_TIMEOUT), stop)
            except Unreachable:
                return None
            except CallTimeout:
                continue
        waited = YIELD_ATTEMPTS * YIELD_TIMEOUT
        raise CommandRefused(f"{peer} did not respond within {waited:g} s, so it may still answer requests")

    async def stop(self, command: commands.YieldCommand) -> replies.Yielded:
        """From the successor. Asked again, it gives the same reply: the first may be lost."""
        self._leave()
        handled = self.admission.close()
        if command.address:
            self.pass_on_to(command.address)
        self.changed()
        return replies.Yielded(handled=handled, goals=self.admission.give_goals())

    def state_moved(self, address: str) -> None:
        """The state has moved to the instance at ``address``, which answers from now on."""
        self.admission.leave()
        self.pass_on_to(address)
        self.changed()  # it now needs time for its goals to end

    def pass_on_to(self, address: str) -> None:
        """Admission is closed, and the instance at ``address`` answers: pass on what only this one receives.

        It also gets what was cancelled here for a request to cancel many goals.
        """
        if self._successor != address:
            self._successor = address
            self.start(self._pass_on(address))

    @property
    def has_successor(self) -> bool:
        """Return whether another instance answers instead."""
        return self._successor is not None

    @property
    def may_pass_on(self) -> bool:
        """Return whether this instance sees to requests that the one that answers instead does not receive."""
        return self.has_successor or (self._page is not None and self._page.answered_before())

    def undecided(self) -> list[str]:
        """Return the requests of which it is not known yet whether the successor has received them."""
        return list(self.admission.passable()) if self.may_pass_on else []

    async def _pass_on(self, address: str) -> None:
        while self._successor == address:
            if self.admission.is_open:  # it answers again
                self._successor = None
                return
            await self._pass_overdue(address)
            for request, response in self.admission.goals.lists_to_send():
                cancelled = commands.CancelledGoalsCommand(request=request, response=response)
                with contextlib.suppress(BackendError):  # it answers with its own list alone
                    await self.call(address, cancelled, MISSING_TIMEOUT)
            await self.sleep(PASS_INTERVAL)

    async def _pass_overdue(self, address: str) -> None:
        held, overdue = self.admission.passable(), self.admission.passable(PASS_AFTER)
        if not held:
            return
        question = commands.MissingRequestsCommand(requests=list(held))
        try:
            missing = result_of(await self.call(address, question, MISSING_TIMEOUT), question).requests
        except Unreachable:  # it has exited, and may have handled them
            self.admission.give_up(held)
            return
        except (BackendError, CommandRefused):
            return  # it is asked again, as long as they are held: also where it does not answer requests yet
        self.admission.give_up(held.keys() - set(missing))
        for request in missing:
            if request in overdue and self.admission.pass_on(request):
                self.start(self._pass(request, overdue[request], address))

    async def _pass(self, request: str, passable: PassableRequest, address: str) -> None:
        serve = commands.ServeCommand(
            request=request, service=passable.service, data=passable.data(), timeout=SERVE_TIMEOUT
        )
        try:
            response = result_of(await self.call(address, serve, SERVE_TIMEOUT), serve).response
            if response is not None:
                passable.respond(response)
        except (BackendError, CommandRefused):
            pass  # as if the server had died: its client gets no response
        finally:
            self.admission.finished(request)

    # -- goals of ROS actions ----------------------------------------------------------------------

    async def _follow(self, address: str) -> None:
        """Until the predecessor has handed over the results of its goals, or has ended without that."""
        ping = commands.PingCommand()
        while self.admission.predecessor_has_goals:
            try:
                await self.call(address, ping, FOLLOW_INTERVAL)
            except Unreachable:
                self.admission.predecessor_ended(None)
            except BackendError:
                pass  # it is busy, or stopped
            await self.sleep(FOLLOW_INTERVAL)

    async def cancelled_goals(self, command: commands.CancelledGoalsCommand) -> replies.Done:
        """From the predecessor: what it has cancelled for a request that this instance answers."""
        self.admission.goals.list_arrived(command.request, command.response)
        return replies.Done()

    async def keep_results(self, command: commands.KeepResultsCommand) -> replies.Done:
        """From the predecessor: it ends, and leaves the results that no client has fetched."""
        self.admission.predecessor_ended(command.results, command.handled)
        return replies.Done()

    async def hand_over_results(self) -> str | None:
        """Before this instance ends: leave the results that no client has fetched to the successor.

        Returns how many are lost, or may be, in words; None where it has them, or there are none.
        """
        if (address := self._successor) is None:
            return None
        goals = self.admission.goals
        results = goals.hand_over()  # from here on, nothing is handled of what is asked about them
        keep = commands.KeepResultsCommand(results=results, handled=goals.requests, timeout=RESULTS_TIMEOUT)
        number = counted(len(keep.results), "result")
        for _ in range(RESULTS_ATTEMPTS):  # kept twice is kept once
            try:
                result_of(await self.call(address, keep, RESULTS_TIMEOUT), keep)
                return None
            except CallTimeout:
                continue
            except MidstrideError as error:
                if not keep.results:
                    return None
                are = "is" if len(keep.results) == 1 else "are"
                return f"{number} that no client had fetched {are} lost, as its successor has not taken them: {error}"
        if not keep.results:
            return None
        return f"it is not known whether its successor has {number} that no client had fetched: it has not responded"

    # -- requests that the predecessor passes on -----------------------------------------------------

    async def missing(self, command: commands.MissingRequestsCommand) -> replies.MissingRequests:
        """From the predecessor. Until admission is open they may yet be handled there."""
        if not self.admission.is_open:
            raise CommandRefused("it does not answer requests yet")
        return replies.MissingRequests(requests=self.admission.missing(command.requests))

    async def serve(self, command: commands.ServeCommand) -> replies.ServedRequest:
        """Handle a request that only the predecessor has received."""
        handle = self.admission.passed_handlers.get(command.service)
        if handle is None:
            raise CommandRefused(f"there is no service {command.service}")
        if not self.admission.admit_passed(command.request, command.service):
            return replies.ServedRequest(response=None)
        loop = asyncio.get_running_loop()
        response: asyncio.Future[bytes | None] = loop.create_future()

        def respond(data: bytes | None) -> None:
            if not response.done():
                response.set_result(data)

        handle(command.request, command.data, lambda data: loop.call_soon_threadsafe(respond, data))
        return replies.ServedRequest(response=await response)
