"""The triggers that drive a mode: a time grid, messages, sets of messages, or only its entry.

A trigger exists from the mode's entry to its end, on the data thread. It has the runner call functions, and says what
places each call in time: a slot of the grid, or the messages that it answers.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeAlias

from midstride.node.author.modes import DeclaredMode, Function
from midstride.node.author.ports import Input, Listener
from midstride.node.component_host import Host, Timer


class Caller(Protocol):
    """Calls user code: the running functionality, as far as a trigger needs to know it."""

    watch: Callable[[Any], None] | None

    def call(
        self, function: Function, arguments: tuple[Any, ...], slots: tuple[int, int] | None, info: Any
    ) -> None: ...

    def request(
        self, function: Function, arguments: tuple[Any, ...], slots: tuple[int, int] | None, info: Any
    ) -> None: ...


class InfoSet(tuple[Any, ...]):
    """The message infos of one set: the newest of them places the call in time."""

    __slots__ = ()


class OnEntry:
    """Called once."""

    def __init__(self, runner: Caller, function: Function) -> None:
        self._runner = runner
        self._function = function

    def begin(self) -> None:
        self._runner.call(self._function, (), None, None)

    def end(self) -> None:
        pass


class OnRate:
    """Called on a time grid, the first time on entry. A slot that comes during a call is skipped."""

    def __init__(self, runner: Caller, host: Host, function: Function, period: float) -> None:
        self.period = period
        self.slot: int | None = None
        self._runner = runner
        self._host = host
        self._function = function
        self._timer: Timer | None = None

    def begin(self) -> None:
        self._timer = self._host.create_timer(self.period, None, self._on_slot)

    def end(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def regrid(self, epoch: int) -> None:
        if self._timer is not None:
            self._timer.regrid(epoch)

    def _on_slot(self, first: int, last: int) -> None:
        self.slot = first
        self._runner.request(self._function, (), (first, last), None)


class _Listening:
    """Listens to inputs: ``handlers`` has the function to call with each message of an input and its info."""

    def __init__(self, runner: Caller, handlers: Sequence[tuple[Input, Listener]]) -> None:
        self._runner = runner
        self._listeners = [(port, self._watched(handler)) for port, handler in handlers]

    def begin(self) -> None:
        for port, listener in self._listeners:
            port.listeners = (*port.listeners, listener)

    def end(self) -> None:
        for port, listener in self._listeners:
            port.listeners = tuple(other for other in port.listeners if other is not listener)

    def _watched(self, handler: Listener) -> Listener:
        runner = self._runner

        def on_message(message: Any, info: Any) -> None:
            if runner.watch is not None:
                runner.watch(info)
            handler(message, info)

        return on_message


class OnMessage(_Listening):
    """Called for every message of its inputs; ``on_entry`` is called before, once."""

    def __init__(
        self, runner: Caller, handlers: tuple[tuple[Input, Function], ...], on_entry: Function | None = None
    ) -> None:
        super().__init__(runner, [(port, self._handler(runner, function)) for port, function in handlers])
        self._on_entry = on_entry

    def begin(self) -> None:
        super().begin()
        if self._on_entry is not None:
            self._runner.request(self._on_entry, (), None, None)

    @staticmethod
    def _handler(runner: Caller, function: Function) -> Listener:
        return lambda message, info: runner.request(function, (message,), None, info)


class OnSet(_Listening):
    """Called with one message of each input whose times lie within the slop: the closest ones."""

    def __init__(self, runner: Caller, host: Host, mode: DeclaredMode) -> None:
        assert mode.sync is not None and mode.function is not None
        self._host = host
        self._function = mode.function
        self._slop = int(mode.sync.slop * 1e9)
        self._waiting: list[deque[tuple[int, Any, Any]]] = [deque(maxlen=mode.sync.queue) for _ in mode.synchronised]
        super().__init__(runner, [(port, self._handler(index)) for index, port in enumerate(mode.synchronised)])

    def _handler(self, index: int) -> Listener:
        def on_message(message: Any, info: Any) -> None:
            self._waiting[index].append((self._time(message, info), message, info))
            self._match(index)

        return on_message

    def _time(self, message: Any, info: Any) -> int:
        stamp = getattr(getattr(message, "header", None), "stamp", None)
        if stamp is not None:
            if hasattr(stamp, "nanosec"):
                return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
            return int(stamp.to_nsec())
        source = self._host.read_info(info).source
        return self._host.now() if source is None else source

    def _match(self, index: int) -> None:
        """Call the function if the newest message of input ``index`` completes a set, and drop older messages."""
        newest = self._waiting[index][-1]
        chosen = []
        for other, waiting in enumerate(self._waiting):
            if other == index:
                chosen.append(newest)
            elif waiting:
                chosen.append(min(waiting, key=lambda entry: abs(entry[0] - newest[0])))
            else:
                return
        times = [time for time, _, _ in chosen]
        if max(times) - min(times) > self._slop:
            return
        for waiting, (time, _, _) in zip(self._waiting, chosen, strict=True):
            while waiting and waiting[0][0] <= time:
                waiting.popleft()
        messages, infos = tuple(message for _, message, _ in chosen), InfoSet(info for _, _, info in chosen)
        self._runner.request(self._function, messages, None, infos)


Trigger: TypeAlias = OnEntry | OnRate | OnMessage | OnSet


def trigger_of(mode: DeclaredMode, runner: Caller, host: Host) -> Trigger:
    if mode.driven == "message":
        return OnSet(runner, host, mode) if mode.sync is not None else OnMessage(runner, mode.handlers, mode.function)
    assert mode.function is not None
    if mode.period is not None:
        return OnRate(runner, host, mode.function, mode.period)
    return OnEntry(runner, mode.function)
