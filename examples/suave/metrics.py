"""SUAVE's metrics of a mission, computed as its node ``mission_metrics`` does: from diagnostics to the reaction.

A reaction time is from the stamp of the diagnostics that report a change to the moment at which its result is seen:
the spiral's altitude is right for the visibility, or the node that recovers thrusters is active.
"""

from dataclasses import dataclass, field
from statistics import fmean

# From which visibility on (m) which altitude is expected (m).
EXPECTED = ((3.25, 3.0), (2.25, 2.0), (1.25, 1.0))


def expected_altitude(visibility: float) -> float | None:
    return next((altitude for least, altitude in EXPECTED if visibility >= least), None)


@dataclass
class Metrics:
    """All times in seconds of one clock; ``altitude`` is that of the best mode, which the search is started in."""

    altitude: float = 3.0
    visibility: float | None = None
    began: float | None = None
    found: float | None = None
    inspected: float = 0.0
    wrong_since: float | None = None
    failed_since: float | None = None
    visibility_reactions: list[float] = field(default_factory=list)
    thruster_reactions: list[float] = field(default_factory=list)

    def on_diagnostic(self, key: str, value: str, stamp: float) -> None:
        if key == "water_visibility":
            self.visibility = float(value)
            if self.wrong_since is None and self.altitude != expected_altitude(self.visibility):
                self.wrong_since = stamp
        elif key.startswith("c_thruster_") and value == "FALSE" and self.failed_since is None:
            self.failed_since = stamp

    def on_altitude(self, altitude: float, now: float) -> None:
        self.altitude = altitude
        if self.wrong_since is None or self.visibility is None or altitude != expected_altitude(self.visibility):
            return
        self.visibility_reactions.append(now - self.wrong_since)
        self.wrong_since = None

    def on_transition(self, goal: str, now: float) -> None:
        if goal == "active" and self.failed_since is not None:
            self.thruster_reactions.append(now - self.failed_since)
            self.failed_since = None

    def row(self, now: float) -> dict[str, float | bool]:
        """The columns of SUAVE's table, and the reactions behind the mean."""
        assert self.began is not None
        duration = int(now - self.began)
        reactions = self.thruster_reactions + self.visibility_reactions
        return {
            "mission duration (s)": duration,
            "pipeline found": self.found is not None,
            "time searching pipeline (s)": duration if self.found is None else int(self.found - self.began),
            "distance inspected (m)": self.inspected,
            "mean reaction time (s)": fmean(reactions) if reactions else 0.0,
            "reactions": len(reactions),
            "longest reaction (s)": max(reactions, default=0.0),
        }
