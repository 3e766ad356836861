"""Control connections to components on another host, through a Unix socket of a host process.

The socket is that of the other host, as SSH forwards it to the manager's host; or that of the own host, whose process
has the manager bring a connection to the component. In both cases the host process greets first, the client says in one
frame which component it means, and the rest of the connection is that component's control connection. The other end is
a program that passes it on: its end says nothing about the component.
"""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Annotated, Final, NamedTuple, TypeAlias

import msgspec
from msgspec import Meta

from midstride.errors import CallTimeout, ProtocolError, Unreachable
from midstride.wire.channel import in_time
from midstride.wire.frames import INVALID, Frame, encode

# The version of the frames between a host process and its clients (:mod:`midstride.runtime.hosts.host_frames`).
HOST_PROTOCOL: Final = 1
# How long a host process may take to greet, and then to connect to a component (s).
GREET_SECONDS: Final = 5.0
_THERE: Final = "host:"
_THROUGH: Final = "manager:"
Word: TypeAlias = Annotated[str, Meta(max_length=256)]


class ComponentHello(Frame, frozen=True, kw_only=True, tag="component"):
    """The rest of the connection is the control connection of this component.

    ``elsewhere``: it is on another host than the process that is asked, which has the manager connect to it.
    """

    protocol: int
    instance: Word
    elsewhere: bool = False


class Accepted(Frame, frozen=True, kw_only=True, tag="accepted"):
    """The client's first frame is accepted; ``refused``: why it is not. ``gone``: nothing listens there.

    ``seen``: the number of the last event that a manager is not sent. A manager that has just begun is sent none of
    those before it, which are about processes that it has not known; nor may it be, when it connects again.
    """

    refused: str | None = None
    gone: bool = False
    seen: int = 0


class OtherHostAddress(NamedTuple):
    """``instance`` is reached by the Unix socket ``socket`` of a host process; see :class:`ComponentHello`."""

    socket: Path
    instance: str
    elsewhere: bool = False

    def __str__(self) -> str:
        return f"{_THROUGH if self.elsewhere else _THERE}{self.socket}#{self.instance}"

    @classmethod
    def read(cls, address: str) -> OtherHostAddress | None:
        """The address of that form; None for another one."""
        for scheme in (_THERE, _THROUGH):
            if address.startswith(scheme):
                socket, _, instance = address.removeprefix(scheme).rpartition("#")
                return cls(Path(socket), instance, scheme == _THROUGH)
        return None


class _Versioned(msgspec.Struct):
    protocol: int


_versioned: Final[msgspec.json.Decoder[_Versioned]] = msgspec.json.Decoder(_Versioned)
_accepted: Final[msgspec.json.Decoder[Accepted]] = msgspec.json.Decoder(Accepted)


async def introduce(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, address: OtherHostAddress) -> None:
    """Have a connection to the socket of ``address`` passed on to the component.

    Raises Unreachable where nothing listens under its name on its host; CallTimeout where that is not known, as the
    host or the manager cannot be reached; ProtocolError.
    """
    hello = ComponentHello(protocol=HOST_PROTOCOL, instance=address.instance, elsewhere=address.elsewhere)
    words = f"the host of {address.instance} did not answer within {GREET_SECONDS:g} s"
    accepted = await in_time(GREET_SECONDS, _introduced(reader, writer, hello), words)
    if accepted.refused is not None:
        raise (Unreachable if accepted.gone else CallTimeout)(accepted.refused)


async def _introduced(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, hello: ComponentHello) -> Accepted:
    """Raises CallTimeout where the other end closes, and ProtocolError."""
    try:
        spoken = _versioned.decode(await _line(reader, hello.instance)).protocol
        if spoken != HOST_PROTOCOL:
            raise ProtocolError(
                f"the `midstride host` on the way to {hello.instance} speaks version {spoken} of the protocol between "
                f"hosts, and this is version {HOST_PROTOCOL}"
            )
        writer.write(encode(hello) + b"\n")
        return _accepted.decode(await _line(reader, hello.instance))
    except INVALID as error:
        raise ProtocolError(f"the way to {hello.instance} answers with something else: {error}") from None


async def _line(reader: asyncio.StreamReader, instance: str) -> bytes:
    words = f"the way to {instance} on its host was closed"
    try:
        line = await reader.readline()
    except (OSError, ValueError) as error:
        raise CallTimeout(f"{words}: {error}") from None
    if not line.endswith(b"\n"):
        raise CallTimeout(words)
    return line
