"""The interface of a transport of the control plane: addresses, connections, listening, and finding components."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Final, Protocol

# The process at the other end of a connection that another program passes on.
FORWARDED: Final = -1


class Connection(Protocol):
    """An ordered, reliable stream of frames. Used on one event loop."""

    @property
    def peer(self) -> int | None:
        """The process at the other end, by its number in its own PID namespace; None where that is not known.

        Where another program forwards the connection (SSH), it is that program, whose end says nothing about the
        component; ``FORWARDED`` where that is known.
        """

    async def send(self, frame: bytes) -> None:
        """Raises Unreachable where the other end is gone."""

    async def receive(self) -> bytes | None:
        """The next frame; None once the other end is gone. Raises ProtocolError for a frame that is too long."""

    def close(self) -> None: ...


Serve = Callable[[Connection], Awaitable[None]]
# Ends listening: no further connections; those that are open stay.
StopListening = Callable[[], None]


class CutLock(Protocol):
    """The right to write what belongs after a cut: at most one of its sides has it, whatever it knows of the other.

    It is free again when its holder gives it back, or when the holder's process ends. Any thread.
    """

    def take(self) -> bool:
        """Take the lock if it is free; return whether this side has it now. Does not wait."""

    def renounce(self) -> bool:
        """Never take it from now on, unless this side has it; whether it has not."""

    def give_back(self) -> None: ...

    @property
    def is_taken(self) -> bool:
        """Return whether another side has it now, as far as that can be seen from here. Takes nothing."""

    @property
    def place(self) -> str:
        """The place of the lock; empty where unknown. Two sides have one lock if they have it in one place."""

    def share(self, place: str) -> None:
        """The other side has it, or had it, in ``place``."""

    def take_freed(self) -> bool:
        """Take the lock from another side that had it; False while it is unknown whether that had the same one.

        That side has then given it back, or its process has ended.
        """


class Transport(Protocol):
    """The addresses at which the components of one system listen: strings that can be sent and stored."""

    async def listen(self, instance: str, serve: Serve) -> StopListening:
        """Have ``serve`` called with each connection to ``instance``. Raises NodeError where the name is taken."""

    async def connect(self, address: str) -> Connection:
        """Raises Unreachable where nothing listens at ``address``, CallTimeout where that is not known.

        It is not where the other end accepts no connection for now, or this process can open none.
        """

    def address(self, instance: str, seen_from: str | None = None) -> str:
        """The address of a component of this system, whether it listens or not; as another component is to use it.

        Without one (``seen_from``), as this process does.
        """

    def cut_lock(self, cut: str) -> CutLock:
        """One side's lock of a cut. Sides on different hosts have different locks, and both get theirs."""

    def present(self) -> dict[str, str]:
        """The components that have an address now, possibly dead ones among them: instance -> address."""
