"""The restart policy of a node: `respawn` and what belongs to it (docs/protocols/faults.md)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from midstride.model.contract import format_number
from midstride.model.hosts import host_in_words

# The longest delay (s) where a policy states none.
LONGEST_DELAY: Final = 30.0
# From the second restart on, the least delay before it (s), unless the longest one is shorter.
SECOND_DELAY: Final = 1.0
# The lease of a node with a fallback on another host where the policy states none (s), and the shortest one: it is
# renewed several times within that, over a link on which a message may be late.
DEFAULT_LEASE: Final = 5.0
SHORTEST_LEASE: Final = 1.0


@dataclass(frozen=True, slots=True)
class RespawnPolicy:
    """The policy for starting a crashed node again, in the words of ROS launch files.

    The first restart comes after ``delay`` (s). Each further one waits twice as long as the one before, at least
    1 s and at most ``max_delay`` (None: 30 s, or ``delay`` where that is longer). After ``max_retries`` restarts (None:
    there is no limit) within ``window`` (s) of the time that the node ran, it is replaced by the component
    ``fallback``, or left.

    With ``fallback_host``, the fallback runs there. Where the host of the node cannot be reached, it takes over once
    the ``lease`` (s; None: 5 s) of the node is surely over, after which the node is silent (docs/protocols/lease.md).
    """

    delay: float = 0.0
    max_delay: float | None = None
    max_retries: int | None = 5
    window: float = 60.0
    fallback: str | None = None
    fallback_host: str | None = None
    lease: float | None = None

    @property
    def lease_seconds(self) -> float:
        return DEFAULT_LEASE if self.lease is None else self.lease

    def falls_back_from(self, component: str, host: str) -> bool:
        """Return whether the fallback is another component than this one, or on another host."""
        return self.fallback is not None and (self.fallback != component or self.leaves(host))

    def leaves(self, host: str) -> bool:
        """Return whether the fallback is on another host than this one."""
        return self.fallback is not None and self.fallback_host is not None and self.fallback_host != host

    def is_leased(self, host: str) -> bool:
        """Return whether a node keeps a lease on ``host``: the manager may lose that, and the fallback is elsewhere."""
        return bool(host) and self.leaves(host)

    @property
    def longest_delay(self) -> float:
        return max(LONGEST_DELAY, self.delay) if self.max_delay is None else self.max_delay

    def delay_before(self, restart: int) -> float:
        """The delay before a restart (s), the first one in the window being number 1."""
        delay = min(self.delay, self.longest_delay)
        for _ in range(1, restart):
            if delay >= self.longest_delay:
                break
            delay = min(max(2 * delay, SECOND_DELAY), self.longest_delay)
        return delay

    @property
    def limit(self) -> str:
        """``5 in 60 s``, or ``unlimited``"""
        if self.max_retries is None:
            return "unlimited"
        return f"{self.max_retries} in {format_number(self.window)} s"

    def numbered(self, restart: int) -> str:
        """``2 of 5 in 60 s``, or ``restart 2, without a limit``"""
        return f"restart {restart}, without a limit" if self.max_retries is None else f"{restart} of {self.limit}"

    def __str__(self) -> str:
        then = "" if self.fallback is None else f", then {self.fallback}"
        if self.fallback_host is not None:
            lease = format_number(self.lease_seconds)
            then += f" on {host_in_words(self.fallback_host)}, with a lease of {lease} s"
        delays = " to ".join(f"{format_number(seconds)} s" for seconds in (self.delay, self.longest_delay))
        return f"after {delays}, {'at most ' if self.max_retries is not None else ''}{self.limit}{then}"
