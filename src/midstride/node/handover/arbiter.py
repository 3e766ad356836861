"""The decision which of the two sides of a cut may write: never both, whatever each of them knows of the other.

Each side has its own arbiter. The right to write passes to the new side when that takes it, and back to the old
one when the new one gives it back, or its process ends (docs/semantics.md section 7).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

from midstride.wire.transport import CutLock


class Arbiter(Protocol):
    """``begin``, ``end`` and ``admits`` are for the data thread, the others for either. None of them waits."""

    def begin(self, output: int) -> bool:
        """Return whether a message may be published on this output of the cut now; if so, :meth:`end` must follow."""

    def end(self) -> None: ...

    def admits(self) -> bool:
        """Return whether this side may write from now on. Where the right is free for it, it may take it."""

    # -- of the new side -------------------------------------------------------------------------------

    def request(self) -> None:
        """Ask for the right."""

    @property
    def refused(self) -> bool:
        """Return whether the old side has the right, and keeps it."""

    def renounce(self) -> bool:
        """Never take the right from now on, unless this side has it; whether it has not."""

    def give_back(self) -> None:
        """Nothing is written here any more: the old side may write again."""

    @property
    def settled(self) -> bool:
        """Return whether this side needs nothing more of its arbiter to keep the right."""

    # -- of the old side -------------------------------------------------------------------------------

    @property
    def passed_on(self) -> bool:
        """Return whether the new side is seen to have the right; where that cannot be seen, it reports it."""

    @property
    def is_overtaken(self) -> bool:
        """Return whether the new side has the right now; it is looked up, so also where the report of it is late."""

    def share(self, place: str) -> None:
        """The new side reports that it has the right, in ``place``."""

    def free(self) -> None:
        """The new side is known never to write again: it has said so, or its process has ended."""

    @property
    def undecided(self) -> bool:
        """Return whether only time can tell which side has the right: then :meth:`reclaim` is to be tried again."""

    def reclaim(self) -> bool:
        """Return whether this side has the right, and keeps it: the new one can no longer take it."""

    def reclaim_freed(self) -> bool:
        """Like :meth:`reclaim`, from a new side that had the right; False while that may still be writing."""

    # -- of both ---------------------------------------------------------------------------------------

    def leave(self) -> None:
        """The cut is over here: free what is shared with the other side. Who may write stays as it is."""


@dataclass(eq=False)
class LockArbiter:
    """Between two components: the side that takes the lock first is the one that writes from the agreed moment on.

    Until then the old side writes without it. The new side takes it before its first write, the old one before it
    writes again.
    """

    lock: CutLock
    refused: bool = field(default=False, init=False)
    settled: bool = field(default=True, init=False)
    passed_on: bool = field(default=False, init=False)
    undecided: bool = field(default=False, init=False)
    _has: bool = field(default=False, init=False)

    def begin(self, output: int) -> bool:
        return True

    def end(self) -> None: ...

    def admits(self) -> bool:
        self.refused = not self.reclaim()
        return not self.refused

    def request(self) -> None: ...

    def renounce(self) -> bool:
        return self.lock.renounce()

    def give_back(self) -> None:
        self._has = False
        self.lock.give_back()

    @property
    def is_overtaken(self) -> bool:
        return self.lock.is_taken

    def share(self, place: str) -> None:
        self.lock.share(place)

    def free(self) -> None:
        """The lock is free, too."""

    def reclaim(self) -> bool:
        self._has = self.lock.take()
        return self._has

    def reclaim_freed(self) -> bool:
        self._has = self._has or self.lock.take_freed()
        return self._has

    def leave(self) -> None:
        if not self._has:
            self.lock.give_back()
