"""The number of attempts so far, which a policy limits (docs/protocols/faults.md)."""

from __future__ import annotations

from dataclasses import dataclass, field

from midstride.model.respawn import RespawnPolicy


@dataclass(slots=True)
class Attempts:
    """Only time during which it runs counts: waiting and starting do not.

    ``made``: when each attempt was decided, in seconds of that time; ``ran``: how much of it has passed, up to
    ``runs_since`` (steady s).
    """

    made: list[float] = field(default_factory=list)
    ran: float = 0.0
    runs_since: float | None = None

    def stopped(self, now: float) -> None:
        """Note that it does not run any more."""
        if self.runs_since is not None:
            self.ran += now - self.runs_since
            self.runs_since = None

    def lately(self, policy: RespawnPolicy, now: float) -> int:
        """Return how many attempts are in the window ``now`` (steady s)."""
        ran = self.ran + (0.0 if self.runs_since is None else now - self.runs_since)
        return sum(ran - at < policy.window for at in self.made)

    def next(self, policy: RespawnPolicy) -> int | None:
        """The number of the next attempt in the window, which counts from now on; None if there is to be no other."""
        self.made = [at for at in self.made if self.ran - at < policy.window]
        if policy.max_retries is not None and len(self.made) >= policy.max_retries:
            return None
        self.made.append(self.ran)
        return len(self.made)
