"""The envelope of the control plane and its one codec: each frame is a JSON object on a line.

The client names the version of the protocol that it speaks, and the token of the system it acts for. The component
greets in that version, if it speaks it, else in its latest; the client then says hello once more, in a new connection.
Then the client sends requests, and the component replies and reports its state.

Of a command and a state, what has a default is written only where it has another value. So an earlier version reads one
with a field that was added, as long as that is not used.
"""

from __future__ import annotations

import re
from functools import reduce
from itertools import accumulate
from operator import or_
from typing import Any, Final, TypeAlias, TypeVar

import msgspec

from midstride.codec.component_form import NamedComponentForm
from midstride.codec.writing import to_json
from midstride.errors import CommandRefused, ProtocolError
from midstride.wire.commands import COMMANDS, Command
from midstride.wire.state import ComponentState, Endpoint, WireValue

# Incremented with every change of a frame, command, reply or event that another version could misread, and of the locks
# of cuts: where two versions lock different files, both sides of a cut get their lock, and both write.
PROTOCOL: Final = 12
# The oldest version that is spoken as well. What another version could misread since then has a default that means what
# that version does.
OLDEST: Final = 10
SPOKEN: Final = range(OLDEST, PROTOCOL + 1)
# From this version on, a greeting says where the locks of cuts are.
WITH_PLACE: Final = 12
# The longest frame (bytes): recorded receipts and exported state included.
LONGEST_FRAME: Final = 256 * 1024 * 1024
# How deep lists and objects in a frame may be nested: each version of Python reads so deep, and none much deeper.
DEEPEST: Final = 500


class Frame(WireValue, frozen=True, kw_only=True, tag_field="frame"):
    """One line."""


class Greeting(Frame, frozen=True, kw_only=True, omit_defaults=True, tag="greeting"):
    """The component's first frame. ``start_token`` is the token it was started with, empty where started by hand.

    ``place``: where its locks of cuts are (:class:`midstride.wire.transport.CutLock`); those of two components exclude
    each other if it is one place.
    """

    protocol: int
    instance: str
    uuid: str
    pid: int
    start_token: str
    place: str = ""


class Hello(Frame, frozen=True, kw_only=True, tag="hello"):
    """The client's first frame."""

    protocol: int
    token: str


class Request(Frame, frozen=True, kw_only=True, tag="request"):
    """A command. A request repeated with the same ``id`` gets the first reply again and changes nothing.

    ``revision``: the one that the sender expects the component to be at; None for commands that change nothing.
    """

    id: str
    command: msgspec.Raw
    revision: int | None = None


class Reply(Frame, frozen=True, kw_only=True, tag="reply"):
    """The outcome of a request. ``refused``: the reason, None where it was carried out. ``revision``: that it is at."""

    id: str
    revision: int
    result: msgspec.Raw = msgspec.Raw(b"null")
    refused: str | None = None

    @property
    def ok(self) -> bool:
        return self.refused is None


class Registration(Frame, frozen=True, kw_only=True, tag="registration"):
    """The component is set up: what it declares, and the endpoints of its node that are not ports."""

    declaration: NamedComponentForm
    endpoints: list[Endpoint]


class StateChanged(Frame, frozen=True, kw_only=True, tag="state"):
    """The component's state, after every change and at regular intervals."""

    state: ComponentState


T = TypeVar("T")
FromComponent: TypeAlias = Greeting | Reply | Registration | StateChanged
FromClient: TypeAlias = Hello | Request


class _Named(msgspec.Struct):
    command: str


class _Versioned(msgspec.Struct):
    protocol: int
    instance: str = "the component"


_named: Final[msgspec.json.Decoder[_Named]] = msgspec.json.Decoder(_Named)
_versioned: Final[msgspec.json.Decoder[_Versioned]] = msgspec.json.Decoder(_Versioned)
_from_component: Final[msgspec.json.Decoder[FromComponent]] = msgspec.json.Decoder(FromComponent)
_from_client: Final[msgspec.json.Decoder[FromClient]] = msgspec.json.Decoder(FromClient)
_command: Final[msgspec.json.Decoder[Command[Any]]] = msgspec.json.Decoder(reduce(or_, COMMANDS.values()))
# One that is not ended goes to the end of the text: nothing of it is tried twice.
_STRING: Final = re.compile(rb'"[^"\\]*(?:\\.?[^"\\]*)*(?:"|\Z)', re.DOTALL)
_NO_BRACKETS: Final = bytes(byte for byte in range(256) if byte not in b"[{]}")
_STEPS: Final = bytes.maketrans(b"[{]}", bytes([2, 2, 0, 0]))  # plus one
# What decoding raises for input that is not valid; msgspec does not translate the last two.
INVALID: Final = (msgspec.DecodeError, UnicodeDecodeError, RecursionError)


def encode(frame: Frame) -> bytes:
    """One line, without its end."""
    return to_json(frame)


def encode_value(value: WireValue) -> msgspec.Raw:
    """``value`` as JSON; of a command, without what equals its default: for msgspec, that is the same object."""
    if isinstance(value, Command):
        fields = ((field.name, field.default) for field in msgspec.structs.fields(value))
        same = {name: default for name, default in fields if default == getattr(value, name)}
        value = msgspec.structs.replace(value, **same)
    return msgspec.Raw(to_json(value))


def decode_greeting(line: bytes) -> Greeting:
    """Raises ProtocolError, which says so where the component speaks no version of the protocol that is spoken here."""
    versioned = _decode(_versioned, line, "a greeting")
    if versioned.protocol not in SPOKEN:
        raise ProtocolError(
            f"{versioned.instance} speaks version {versioned.protocol} of the control protocol, and this version of "
            f"Midstride speaks {OLDEST} to {PROTOCOL}: {_remedy(versioned.protocol)}"
        )
    frame = _decode(_from_component, line, "a greeting")
    if not isinstance(frame, Greeting):
        raise ProtocolError("the component did not greet first")
    return frame


def _remedy(protocol: int) -> str:
    if protocol > PROTOCOL:
        return "a newer version of Midstride has started it; use that one"
    return (
        "an earlier version of Midstride has started it; use that one, or restart it (`midstride down` and `up`, where "
        "the system has started it)"
    )


def decode_from_component(line: bytes) -> FromComponent:
    """Raises ProtocolError."""
    return _decode(_from_component, line, "a frame of a component")


def decode_from_client(line: bytes) -> FromClient:
    """Raises ProtocolError."""
    return _decode(_from_client, line, "a frame of a client")


def _decode(decoder: msgspec.json.Decoder[T], line: bytes, what: str) -> T:
    if nested_too_deep(line):
        raise ProtocolError(f"not {what}: nested more than {DEEPEST} deep")
    try:
        return decoder.decode(line)
    except INVALID as error:
        raise ProtocolError(f"not {what}: {error}") from None


def nested_too_deep(line: bytes) -> bool:
    """Return whether lists and objects are nested more than ``DEEPEST`` deep in what may be JSON."""
    if line.count(b"[") + line.count(b"{") <= DEEPEST:  # most frames: whatever of these is in strings
        return False
    brackets = _STRING.sub(b"", line).translate(_STEPS, _NO_BRACKETS)
    return max(accumulate(brackets, lambda depth, step: depth + step - 1, initial=0)) > DEEPEST


def decode_command(request: Request) -> Command[Any]:
    """Raises CommandRefused, naming the field that is unknown, missing or of another type."""
    try:
        return _command.decode(request.command)
    except INVALID as error:
        name = command_name(request)
        if name in COMMANDS:
            raise CommandRefused(f"`{name}`: {error}") from None
        raise CommandRefused(f"{name!r} is not a command; the commands are {', '.join(COMMANDS)}") from None


def command_name(request: Request) -> str:
    """The name of a request's command, known or not."""
    try:
        return _named.decode(request.command).command
    except INVALID:
        return ""
