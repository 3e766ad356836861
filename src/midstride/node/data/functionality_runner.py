"""A running functionality: its current mode, its calls, and what happens when one raises.

Everything here runs on the data thread. The control thread reads ``index``, ``busy``, ``because`` and ``since``, and
changes things only through functions that it has run on the data thread.
"""

from __future__ import annotations

import inspect
import traceback
from collections import deque
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any, Final, Literal, NamedTuple, TypeAlias

from midstride.errors import Unanswered
from midstride.node.author.client_ports import ClientPort
from midstride.node.author.functionality import Functionality
from midstride.node.author.modes import DeclaredMode, Function
from midstride.node.author.ports import Driven, Input, OutputOwner
from midstride.node.author.server_ports import ServerPort
from midstride.node.component_host import Host
from midstride.node.data.trigger import OnRate, Trigger, trigger_of
from midstride.node.legible import legible
from midstride.wire.state import FunctionalityState

# What user code may raise without taking the node down; sys.exit() in a callback is one of its errors.
CAUGHT: Final = (Exception, SystemExit)


# How many calls a functionality holds back for a transfer of state; the oldest are dropped first.
HELD: Final = 1000


class Call(NamedTuple):
    """A call that a trigger has asked for: of a message (``info``), or of the slots that it accounts for."""

    function: Function
    arguments: tuple[Any, ...]
    slots: tuple[int, int] | None
    info: Any


# During a transfer of state: whether a call is made, held back, or dropped (midstride.node.handover.state_transfer).
Admission: TypeAlias = Literal["make", "hold", "drop"]


class FunctionalityRunner(OutputOwner):
    """Runs one functionality. ``report`` is called when it has degraded by itself."""

    def __init__(self, functionality: Functionality, host: Host, report: Callable[[FunctionalityRunner], None]) -> None:
        self.name = functionality.name
        self.chain: tuple[DeclaredMode, ...] = functionality.chain()
        self.inputs = functionality.inputs
        self.outputs = functionality.outputs
        self.index = len(self.chain) - 1
        self.because = "it has been in this mode since it started"
        self.since = host.steady()
        # How many modes it has entered.
        self.entered = 0
        # The mode that it is to enter as soon as the call under way returns, and why: its state shows that already.
        self.falling: tuple[int, str] | None = None
        # Whether the local reflex has entered the current mode.
        self.reflex = False
        # Whether a condition that does not hold, and nothing else, is why it is not in a better mode.
        self.conditional = False
        # Whether a call may start. Only an async call, a switch that waits for one, or a hold makes it False.
        self.ready = True
        self._host = host
        self._steady = host.steady
        self._report = report
        self._trigger: Trigger | None = None
        # Whether an async call is under way; the data thread is free meanwhile.
        self.asynchronous = False
        self._error: BaseException | None = None
        # Attempts the mode switch that waits for the async call to end (midstride.node.data.mode_switch).
        self._switch: Callable[[], None] | None = None
        depths = [port.assumption.qos.effective().depth or 1 for port in functionality.inputs]
        self._depth = max(depths, default=1)
        self._postponed: deque[Call] = deque(maxlen=self._depth)
        self.admission: Callable[[FunctionalityRunner, Call], Admission] | None = None
        self._held: deque[Call] = deque(maxlen=HELD)
        self._promise()

    @property
    def mode(self) -> DeclaredMode:
        return self.chain[self.index]

    def current_mode(self) -> str:
        return self.mode.name

    def state(self) -> FunctionalityState:
        now, busy = self._steady(), self.busy
        index, because = self.falling or (self.index, self.because)
        return FunctionalityState(
            mode=self.chain[index].name,
            since=(now - self.since) / 1e9,
            because=because,
            busy=None if busy is None else (now - busy) / 1e9,
            reflex=self.reflex or self.falling is not None,
            conditional=self.conditional and self.falling is None,
        )

    @property
    def driven(self) -> Driven:
        return self.mode.driven

    @property
    def awaits(self) -> bool:
        """True while an async call is under way that ends before the mode: not one that the mode has begun on entry."""
        return self.asynchronous and self.driven != "none"

    @property
    def driving(self) -> tuple[Input, ...]:
        return self.mode.synchronised or tuple(port for port, _ in self.mode.handlers)

    @property
    def switching(self) -> bool:
        """Return whether a mode change waits for an async call to end."""
        return self._switch is not None

    @property
    def last(self) -> int:
        return len(self.chain) - 1

    @property
    def rate(self) -> OnRate | None:
        """The time grid it runs on, where its mode has one."""
        return self._trigger if isinstance(self._trigger, OnRate) else None

    def stop_calls(self) -> None:
        """Start no further call of the current mode."""
        if self._trigger is not None:
            self._trigger.end()
            self._trigger = None
        self._postponed.clear()
        self._held.clear()

    def enter_mode(
        self, index: int, because: str, failed: bool = False, reflex: bool = False, conditional: bool = False
    ) -> None:
        """Switch to mode ``index``; :meth:`start_calls` starts its calls.

        ``conditional``: of the reflex, a condition is why. A command that does not lead to the best mode changes
        nothing about that.
        """
        commanded = not failed and not reflex
        self.conditional = conditional or (commanded and self.conditional and index > 0)
        if self.driven != "none":
            for output in self.outputs:
                output.forget_kept()
        self.index = index
        self.because = because
        self.since = self._steady()
        self.calls = 0
        self.failed = failed
        self.reflex = reflex
        self.falling = None
        self.entered += 1
        for port in self.inputs:
            if isinstance(port, ClientPort):
                port.enter_mode()
        self._promise()

    def _promise(self) -> None:
        for port in self.outputs:
            port.promise(self.mode.promise(port))
            if isinstance(port, ServerPort):
                port.serve(port in self.mode.outputs)

    def start_calls(self) -> None:
        """Start the current mode's calls; the first may come at once. Errors of the platform count as the mode's."""
        self._trigger = trigger_of(self.mode, self, self._host)
        try:
            self._trigger.begin()
        except Exception as error:  # the platform's: those of user code are caught where it is called
            self._fail(error)

    def block(self, switch: Callable[[], None]) -> None:
        """Start no further call until :meth:`unblock`; ``switch`` is called when the call under way ends."""
        self._switch = switch
        self.ready = False

    def unblock(self, switch: Callable[[], None]) -> None:
        """The switch has happened, or will not: calls may start again."""
        if self._switch == switch:
            self._switch = None
            self.ready = not self.asynchronous
            self._catch_up()

    def request(self, function: Function, arguments: tuple[Any, ...], slots: tuple[int, int] | None, info: Any) -> None:
        """A trigger asks for a call: it is made now, later or never."""
        if self.admission is not None and not self._admitted(Call(function, arguments, slots, info)):
            return
        if self.ready:
            self.call(function, arguments, slots, info)
        elif slots is None:  # queued as the middleware would; a slot that comes during a call is skipped
            self._postponed.append(Call(function, arguments, slots, info))

    def _admitted(self, call: Call) -> bool:
        assert self.admission is not None
        admission = self.admission(self, call)
        if admission == "hold":
            if call.slots is not None and self._held:  # one late call accounts for all these slots
                first, last = self._held.pop().slots or call.slots, call.slots
                call = call._replace(slots=(first[0], last[1]))
            self._held.append(call)
        return admission == "make"

    def make_held(self) -> None:
        """Make the calls that were held back and are not to be dropped, in order, before any other."""
        admission = self.admission
        held = [call for call in self._held if admission is None or admission(self, call) == "make"]
        waiting = [*held, *self._postponed]
        self._held.clear()
        self._postponed = deque(waiting, maxlen=max(self._depth, len(waiting)))
        self._catch_up()

    def drop_held(self) -> None:
        self._held.clear()

    def call(self, function: Function, arguments: tuple[Any, ...], slots: tuple[int, int] | None, info: Any) -> None:
        """Call user code. The caller has checked ``ready``."""
        self.slots = slots
        self.info = info
        self.busy = self._steady()
        try:
            result = function(*arguments)
        except CAUGHT as error:
            self._ended()
            self._fail(error)
            return
        if result is not None and inspect.iscoroutine(result):
            self.asynchronous = True
            self.ready = False
            self._host.run_coroutine(self._guarded(result), self._returned)
        else:
            self._ended()

    def _ended(self) -> None:
        self.calls += 1
        self.busy = None
        self.slots = None
        self.info = None

    def answer(self, server: ServerPort, request: Any, response: Any) -> Any:
        """Call the function of ``server``: the response, or an awaitable of it. Where it raises, the mode has failed.

        Then the server refuses, or does not respond.
        """
        entered = self.entered

        def failed(error: BaseException) -> Any:
            self.request_failed(server, entered, error)
            return server.refuse(request, response)

        async def finish(awaitable: Awaitable[Any]) -> Any:
            try:
                return server.fitted(await awaitable, response)
            except CAUGHT as error:
                return failed(error)

        try:
            result = server.function(request, response)
            return finish(result) if inspect.isawaitable(result) else server.fitted(result, response)
        except CAUGHT as error:
            return failed(error)

    def request_failed(self, server: ServerPort, entered: int, error: BaseException) -> None:
        """Fail, if still in the mode, by its number, in which the request came for which ``server`` has raised."""
        self._host.logger.error(f"the function of server {server.name} raised {format_error(error)}")
        if not server.serving or self.entered != entered:
            return
        if self.asynchronous:
            self._fail_later(error)
        else:
            self._fail(error)

    def _fail_later(self, error: BaseException) -> None:
        """Fail once the async call under way has ended. The state shows it already, and its servers serve no more."""
        self._error = error
        self.falling = self.last, f"a server raised: {format_error(error)}"
        for port in self.outputs:
            if isinstance(port, ServerPort):
                port.serve(False)
        self._report(self)

    async def _guarded(self, coroutine: Coroutine[Any, Any, Any]) -> None:
        try:
            await coroutine
        except GeneratorExit:
            raise
        except Unanswered as error:  # what it relies on has gone: the local reflex degrades it
            self._host.logger.warning(f"a call of {self.name} ended: {error}")
        except BaseException as error:  # a cancelled call has not done its work either
            self._error = error

    def _returned(self) -> None:
        self.asynchronous = False
        error, self._error = self._error, None
        self._ended()
        self.ready = self._switch is None
        if error is not None:
            self._fail(error)
        if self._switch is not None:
            self._switch()
        else:
            self._catch_up()

    def _catch_up(self) -> None:
        while self._postponed and self.ready:
            self.call(*self._postponed.popleft())

    def _fail(self, error: BaseException) -> None:
        """User code has raised: go to the last mode at once, with the traceback as the reason."""
        failed = self.mode.name
        reason = format_error(error)
        self.stop_calls()
        was_last = self.index == self.last
        raised = f"its last mode, {failed}, raised, so it is no longer called" if was_last else f"mode {failed} raised"
        self.enter_mode(self.last, f"{raised}: {reason}", failed=True)
        for port in self.outputs if was_last else ():
            if isinstance(port, ServerPort):
                port.serve(False)
        self._report(self)
        if not was_last:
            self.start_calls()


def format_error(error: BaseException) -> str:
    """The exception, then its traceback from the user's code on; legible."""
    frames = traceback.extract_tb(error.__traceback__)
    own = __file__.rpartition("/data/")[0]  # the package `node`
    theirs = [frame for frame in frames if not frame.filename.startswith(own)] or list(frames)
    lines = "".join(traceback.format_list(theirs))
    return legible(f"{''.join(traceback.format_exception_only(type(error), error)).strip()}\n{lines}".rstrip())
