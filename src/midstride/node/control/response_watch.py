"""Judges whether a server keeps its bound, by what its process has recorded of the requests to it.

docs/protocols/foreign.md. A request has missed the bound when it is answered late, or is not answered although the
bound is over; what is tolerated is stated in missed requests, as for messages, and counts as so many bounds of time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, Protocol

from midstride.node.control.shortfall import LONG_FLOOR, tolerated_periods
from midstride.wire.state import MeasuredResponses

# A process whose helper thread has not looked for so long is stopped (s): it looks ten times a second.
STOPPED: Final = 3.0
_WRAP: Final = 2**32


# How soon after a server has ceased to wait for requests it has taken one that it then answers (s): not all middlewares
# say when it arrived.
TAKEN: Final = 0.1


class AnsweringServer(Protocol):
    """The number of requests that a server has ``answered``, and the times that the last ones ``took`` (us).

    That of response n is at n modulo the length of ``took``.
    """

    @property
    def answered(self) -> int: ...
    @property
    def took(self) -> Sequence[int]: ...


def latest_responses(server: AnsweringServer, known: int | None) -> tuple[int, list[float]]:
    """The number of requests that it has answered, and the time of each response since it had answered ``known`` (s).

    Of more than are kept, the last ones; none where ``known`` is None.
    """
    answered, kept = int(server.answered), len(server.took)
    new = 0 if known is None else (answered - known) % _WRAP
    return answered, [server.took[number % kept] / 1e6 for number in range(answered - min(new, kept), answered)]


class RecordedServer(AnsweringServer, Protocol):
    """A server as its process records it, on one clock (ns).

    ``waiting``: since when the oldest request is not answered; ``busy``: since when nothing waits for requests; 0 where
    none, or something, does.
    """

    @property
    def waiting(self) -> int: ...
    @property
    def busy(self) -> int: ...


def all_of_it(seconds: float) -> float | None:
    """Count all of the last ``seconds``, as where the clock of the records is the one of the bound."""
    return seconds


class ResponseWatch:
    """Watches one server for a bound of ``within`` (s). ``missed``: how many requests may miss it in succession.

    Where that is not stated, they are as many as messages of a topic, and no less than 5 s. Times are those of the
    clock of the records, in ns.
    """

    def __init__(self, within: float, missed: int | None = None) -> None:
        self.within = within
        self._missed = tolerated_periods(1 / within, missed, 0.0) - 1
        self.tolerated = tolerated_periods(1 / within, missed, LONG_FLOOR if missed is None else 0.0) * within
        self._known: tuple[int, int] | None = None  # the server that it has looked at last: its node and process
        self._restart()

    def _restart(self) -> None:
        self._answered: int | None = None
        self._kept = 0  # when it was last known to keep the bound
        self._late_since = 0  # when the first late request in succession came
        self._late_at = 0  # when the last of them was answered
        self._lates = 0  # how many they are
        self._beat, self._beat_at = -1, 0
        self.answered = self.late = 0
        self._longest: float | None = None
        self._silent: tuple[str, float] | None = None

    def look(
        self,
        server: RecordedServer | None,
        process: tuple[int, int],
        beat: int,
        now: int,
        due: Callable[[float], float | None] = all_of_it,
        speed: float = 1.0,
    ) -> None:
        """See what ``server`` of ``process`` has done since the last look; None: there is none.

        ``process``: which one it is; ``beat``: how often it has looked for requests. Where the bound is on another
        clock than the records, ``due`` says how much of the last seconds counts on that (None: not known), and
        ``speed`` how many of its seconds go by in one of theirs.
        """
        known = None if server is None else process
        if known != self._known:
            self._known = known
            self._restart()
        if server is None:
            return
        self._see_responses(server, now, speed)
        if beat != self._beat:
            self._beat, self._beat_at = beat, now
        self._silent = self._silence(server, now, due)

    def _see_responses(self, server: RecordedServer, now: int, speed: float) -> None:
        self._answered, found = latest_responses(server, self._answered)
        self._longest = None
        for seconds in found:
            took = seconds * speed
            self.answered += 1
            self._longest = max(took, self._longest or 0.0)
            if took <= self.within:
                self._kept, self._lates = now, 0
                continue
            self.late += 1
            self._late_since = self._late_since if self._lates else now - int(took * 1e9)
            self._lates, self._late_at = self._lates + 1, now

    def _silence(
        self, server: RecordedServer, now: int, due: Callable[[float], float | None]
    ) -> tuple[str, float] | None:
        """Return what the server fails to do, in words, and for how long (s); None where it does.

        One request that is never answered is one that has missed the bound: where others are answered in time, it is no
        silence.
        """
        found = []
        waiting, busy = int(server.waiting), int(server.busy)
        if waiting:
            found.append((max(waiting, self._kept), "has not answered a request"))
        if busy and not 0 <= waiting - busy < TAKEN * 1e9:
            found.append((max(busy, self._kept), "has not waited for requests"))
        if now - self._beat_at > STOPPED * 1e9:
            found.append((self._beat_at, "has not run"))
        if self._lates > self._missed and now - self._late_at <= self.tolerated * 1e9:
            found.append((self._late_since, "has answered late"))
        if not found:
            return None
        since, words = min(found)
        seconds = due(max(0, now - since) / 1e9)
        return None if seconds is None else (words, seconds)

    @property
    def broken(self) -> bool:
        """Return whether the server breaks its bound."""
        return self._silent is not None and self._silent[1] > self.tolerated

    @property
    def responses(self) -> MeasuredResponses:
        """Return the measured responses, to report."""
        words, silent = self._silent or (None, 0.0)
        return MeasuredResponses(
            within=self.within,
            tolerated=self.tolerated,
            answered=self.answered,
            late=self.late,
            longest=self._longest,
            silent=silent,
            broken=words if self.broken else None,
        )
