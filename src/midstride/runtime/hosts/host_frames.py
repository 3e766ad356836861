"""The frames between a manager and the host process of another host: a line of JSON each, as in :mod:`midstride.wire`.

The host process greets first, with the version of this protocol. Then the client says what the connection is for: the
calls of one manager (:class:`ManagerHello`), those of a reader (:class:`ReaderHello`), or one component's control
connection (:class:`ComponentHello`, :class:`BroughtHello`), which the host process passes on from there. Incremented is
``HOST_PROTOCOL`` with every change of a frame or call that another version could misread.
"""

from __future__ import annotations

import asyncio
from typing import Final, TypeAlias, TypeVar

import msgspec

from midstride.codec.writing import to_json
from midstride.errors import ProtocolError
from midstride.runtime.hosts.call_forms import ExitedForm, HostCall, OtherNodesForm
from midstride.wire.frames import INVALID, Frame
from midstride.wire.other_hosts import HOST_PROTOCOL as HOST_PROTOCOL
from midstride.wire.other_hosts import Accepted as Accepted
from midstride.wire.other_hosts import ComponentHello as ComponentHello
from midstride.wire.other_hosts import Word

# The longest frame that either side takes (bytes): a log's end, or a launch with its parameters.
LONGEST_HOST_FRAME: Final = 16 * 1024 * 1024


class HostGreeting(Frame, frozen=True, kw_only=True, tag="host"):
    """The first frame of the host process. ``control``: the version of the control protocol of its components.

    ``uuid`` identifies the process; ``running``: how many components it watches; ``variables`` and
    ``middleware_settings``: those of the order that it was started with.
    """

    protocol: int
    version: Word
    control: int
    system: Word
    host: Word
    uuid: Word
    pid: int
    running: int = 0
    variables: dict[str, str] = {}
    middleware_settings: bool = True


class ManagerHello(Frame, frozen=True, kw_only=True, tag="manager"):
    """The manager of the system with ``token``. ``seen``: the number of the last event that it has had of ``uuid``."""

    protocol: int
    token: str
    uuid: str = ""
    seen: int = 0


class ReaderHello(Frame, frozen=True, kw_only=True, tag="reader"):
    """A client that changes nothing: it makes calls of the kinds in ``READING``."""

    protocol: int


class BroughtHello(Frame, frozen=True, kw_only=True, tag="brought"):
    """The rest of the connection is the control connection that the host process has asked for by ``number``.

    ``refused``: why there is none; ``gone``: nothing listens there.
    """

    protocol: int
    number: int
    refused: str | None = None
    gone: bool = False


class CallFrame(Frame, frozen=True, kw_only=True, tag="call"):
    """A call of the back end; its result has the same number."""

    number: int
    call: HostCall


class ResultFrame(Frame, frozen=True, kw_only=True, tag="result"):
    """The result of a call; ``failed``: what the back end has raised, of the ``kind`` of error."""

    number: int
    result: msgspec.Raw = msgspec.Raw(b"null")
    failed: str | None = None
    kind: Word = ""


class ExitFrame(Frame, frozen=True, kw_only=True, tag="exited"):
    """A component has exited unexpectedly. Events are numbered from 1 in each host process."""

    number: int
    exited: ExitedForm


class WantedFrame(Frame, frozen=True, kw_only=True, tag="wanted"):
    """A component here wants a control connection to ``instance``, which is not here: see :class:`BroughtHello`."""

    number: int
    instance: Word


class StateFrame(Frame, frozen=True, kw_only=True, tag="state"):
    """The answers to what is asked of a back end without waiting, as of now: pushed when they change."""

    stopped: list[str] = []
    hanging: list[str] = []
    unwritten: str | None = None
    others: dict[str, OtherNodesForm] = {}
    spares: int = 0


T = TypeVar("T")
FromHost: TypeAlias = HostGreeting | Accepted | ResultFrame | ExitFrame | WantedFrame | StateFrame
FromManager: TypeAlias = ManagerHello | ReaderHello | ComponentHello | BroughtHello | CallFrame
_from_host: Final[msgspec.json.Decoder[FromHost]] = msgspec.json.Decoder(FromHost)
_from_manager: Final[msgspec.json.Decoder[FromManager]] = msgspec.json.Decoder(FromManager)


class _Versioned(msgspec.Struct):
    protocol: int


_versioned: Final[msgspec.json.Decoder[_Versioned]] = msgspec.json.Decoder(_Versioned)


def encode(frame: Frame) -> bytes:
    """One line, without its end."""
    return to_json(frame)


async def write(writer: asyncio.StreamWriter, frame: Frame) -> None:
    """Send a frame as a line, and wait until the other end keeps up. Raises OSError."""
    writer.write(encode(frame) + b"\n")
    await writer.drain()


def decode_greeting(line: bytes) -> HostGreeting:
    """Raises ProtocolError, which says so where the host process speaks another version."""
    spoken = _decode(_versioned, line, "the greeting of a host process").protocol
    if spoken != HOST_PROTOCOL:
        raise ProtocolError(other_version(spoken))
    frame = _decode(_from_host, line, "the greeting of a host process")
    if not isinstance(frame, HostGreeting):
        raise ProtocolError("the host process did not greet first")
    return frame


def other_version(spoken: int) -> str:
    """The reason why a host process that speaks version ``spoken`` cannot be used."""
    return (
        f"its `midstride host` speaks version {spoken} of the protocol between hosts, and this is version "
        f"{HOST_PROTOCOL}: install the same version of Midstride on both, then `midstride down` and `midstride up`"
    )


def decode_from_host(line: bytes) -> FromHost:
    """Raises ProtocolError."""
    return _decode(_from_host, line, "a frame of a host process")


def decode_from_manager(line: bytes) -> FromManager:
    """Raises ProtocolError."""
    return _decode(_from_manager, line, "a frame of a manager")


def _decode(decoder: msgspec.json.Decoder[T], line: bytes, what: str) -> T:
    try:
        return decoder.decode(line)
    except INVALID as error:
        raise ProtocolError(f"not {what}: {error}") from None
