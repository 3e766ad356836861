"""Modes as an author declares them: a function, its trigger, its assumptions and its guarantees."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from midstride.errors import NodeError
from midstride.node.author.client_ports import ClientPort
from midstride.node.author.declared_contracts import NO_PROMISE, Guarantee, check_name, check_rate, check_seconds
from midstride.node.author.ports import AnyOf, Driven, Input, Output
from midstride.node.author.server_ports import ServerPort

Function: TypeAlias = Callable[..., Any]
ModeFunction: TypeAlias = Function | Mapping[Input, Function]
Promise: TypeAlias = Guarantee | float | int


@dataclass(frozen=True, slots=True)
class Approximate:
    """Sets of messages whose times lie within ``slop`` seconds. Created by :func:`approximate`."""

    slop: float
    queue: int


def approximate(slop: float, queue: int = 10) -> Approximate:
    """For ``sync=approximate(0.05)``: call the mode with one message of each input, at most ``slop`` seconds apart.

    The time of a message is its ``header.stamp`` if it has one, otherwise the time of its publication. At most
    ``queue`` messages of each input wait to be matched; the oldest are dropped first. Raises NodeError.
    """
    seconds = check_seconds(slop, "approximate()")
    if not queue >= 1:
        raise NodeError(f"approximate(queue={queue!r}): write a queue of at least one message")
    return Approximate(seconds, int(queue))


@dataclass(frozen=True, slots=True)
class DeclaredMode:
    """One mode, checked. ``handlers`` maps inputs to functions where messages drive it; ``function`` is then called
    with sets of messages (``sync``), or once, on entry."""

    name: str
    driven: Driven
    function: Function | None
    rate: float | None
    assumptions: tuple[tuple[Input, ...], ...]
    outputs: tuple[Output, ...]
    guarantees: Mapping[Output, Guarantee]
    handlers: tuple[tuple[Input, Function], ...] = ()
    sync: Approximate | None = None
    synchronised: tuple[Input, ...] = ()

    @property
    def period(self) -> float | None:
        return None if self.rate is None else 1.0 / self.rate

    def promise(self, port: Output) -> Guarantee:
        """The guarantee of the mode for an output. Its rate is that of its calls, unless another one is stated."""
        stated = self.guarantees.get(port, NO_PROMISE)
        if port not in self.outputs or stated.rate is not None:
            return stated
        return Guarantee(self.rate, stated.where)


def declare_mode(
    where: str,
    associated: tuple[Sequence[Input], Sequence[Output]],
    name: object,
    function: object,
    rate: object,
    inputs: object,
    outputs: object,
    guarantees: object,
    sync: object,
) -> DeclaredMode:
    """Check what an author declared for a mode. Raises NodeError with what to write instead.

    ``associated``: the inputs and the outputs of its functionality.
    """
    mode = check_name(name, f"{where}: a mode's name")
    where = f"{where}, mode {mode}"
    hertz = check_rate(rate, where)
    assumptions = _assumptions(where, inputs, associated[0])
    kept_outputs = _outputs(where, outputs, associated[1])
    promises = _promises(where, guarantees or {}, kept_outputs)
    # Messages drive a mode; a client has none.
    with_messages = [tuple(port for port in each if not isinstance(port, ClientPort)) for each in assumptions]
    topical = tuple(filter(None, with_messages))
    named = tuple(dict.fromkeys(port for assumption in topical for port in assumption))
    if sync is not None and not isinstance(sync, Approximate):
        raise NodeError(f"{where}: sync={sync!r}; write sync=approximate(0.05)")
    if hertz is not None or not named:
        if sync is not None:
            raise NodeError(f"{where}: sync= goes with inputs and without rate=; leave one of them out")
        called = "at its rate" if hertz is not None else "once, on entry"
        plain = _callable(where, function, 0, f"it is called {called}, without arguments")
        driven: Driven = "rate" if hertz is not None else "none"
        return DeclaredMode(mode, driven, plain, hertz, assumptions, kept_outputs, promises)
    if sync is not None:
        if any(len(assumption) > 1 for assumption in topical) or len(named) < 2:
            raise NodeError(
                f"{where}: sync= takes one message of each of several inputs, so any_of() cannot be used with it"
            )
        listed = ", ".join(port.name for port in named)
        together = _callable(where, function, len(named), f"it is called with one message of each input: ({listed})")
        return DeclaredMode(
            mode, "message", together, None, assumptions, kept_outputs, promises, sync=sync, synchronised=named
        )
    handlers = _handlers(where, function, topical, named)
    return DeclaredMode(mode, "message", None, None, assumptions, kept_outputs, promises, handlers)


def _handlers(
    where: str, function: object, assumptions: tuple[tuple[Input, ...], ...], named: tuple[Input, ...]
) -> tuple[tuple[Input, Function], ...]:
    if isinstance(function, Mapping):
        for port in function:
            if port not in named:
                raise NodeError(
                    f"{where}: the mapping has a function for {port!r}, which inputs= does not name; add it there"
                )
        if not function:
            raise NodeError(f"{where}: an empty mapping calls no function; write {{scan: on_scan}}")
        called = "it is called with each message"
        return tuple((port, _callable(where, handler, 1, called)) for port, handler in function.items())
    if len(assumptions) > 1:
        pairs = ", ".join(f"{port.name}: on_{port.name}" for port in named)
        raise NodeError(f"{where}: with several inputs write a mapping {{{pairs}}}, sync=approximate(0.05), or a rate=")
    handler = _callable(where, function, 1, "it is called with each message of its input")
    return tuple((port, handler) for port in named)


def _callable(where: str, function: object, arguments: int, called: str) -> Function:
    if isinstance(function, Mapping):
        raise NodeError(f"{where}: a mapping goes with inputs and without rate= or sync=; {called}: write a function")
    if not callable(function):
        raise NodeError(f"{where}: {function!r} is not a function; {called}")
    try:
        inspect.signature(function).bind(*([None] * arguments))
    except TypeError as error:
        name = getattr(function, "__name__", repr(function))
        raise NodeError(f"{where}: {name}{inspect.signature(function)} does not fit ({error}): {called}") from None
    except ValueError:
        pass  # a built-in without a signature
    return function


def _assumptions(where: str, inputs: object, associated: Sequence[Input]) -> tuple[tuple[Input, ...], ...]:
    found: list[tuple[Input, ...]] = []
    for entry in listed(inputs, where, "inputs"):
        if isinstance(entry, AnyOf):
            alternatives = entry.inputs
        elif isinstance(entry, Input):
            alternatives = (entry,)
        else:
            raise NodeError(f"{where}: inputs= has {entry!r}, which is not an input; write what create_input returned")
        for port in alternatives:
            _check_associated(where, "input", port, associated)
        found.append(alternatives)
    return tuple(found)


def _outputs(where: str, outputs: object, associated: Sequence[Output]) -> tuple[Output, ...]:
    found = listed(outputs, where, "outputs")
    for port in found:
        if not isinstance(port, Output):
            raise NodeError(
                f"{where}: outputs= has {port!r}, which is not an output; write what create_output returned"
            )
        _check_associated(where, "output", port, associated)
    return tuple(found)


def _check_associated(where: str, kind: str, port: Input | Output, associated: Sequence[object]) -> None:
    if port not in associated:
        raise NodeError(
            f"{where}: {kind} {port.name} is not one of its functionality; "
            f"write create_functionality(…, {kind}s=[…, {port.name}])"
        )


def _promises(where: str, guarantees: object, outputs: tuple[Output, ...]) -> dict[Output, Guarantee]:
    if not isinstance(guarantees, Mapping):
        raise NodeError(f"{where}: guarantees={guarantees!r}; write {{out: 20}} (Hz) or {{out: guarantee(…)}}")
    promises: dict[Output, Guarantee] = {}
    for port, promise in guarantees.items():
        if port not in outputs:
            raise NodeError(f"{where}: guarantees= names {port!r}, which outputs= of the mode does not; add it there")
        if isinstance(port, ServerPort):
            raise NodeError(
                f"{where}: guarantees= names server {port.name}; its bound is stated in create_server(within=)"
            )
        if promise is None:
            raise NodeError(
                f"{where}: guarantees= of {port.name}: None states nothing, leave it out; a mode with a rate "
                "guarantees that rate for all its outputs, so give an output that is written now and then to a "
                "functionality whose mode has none"
            )
        if not isinstance(promise, Guarantee):
            promise = Guarantee(check_rate(promise, f"{where}, guarantees= of {port.name}"), ())
        promises[port] = promise
    return promises


def listed(values: Any, where: str, what: str) -> list[Any]:
    """``values`` as a list. Raises NodeError for a single port, which is a common mistake."""
    if isinstance(values, (Input, Output, AnyOf, str)) or not isinstance(values, Iterable):
        raise NodeError(f"{where}: {what}={values!r} must be a list; write {what}=[{getattr(values, 'name', '…')}]")
    return list(values)
