"""An event of the manager, the same for every version that benchmarks/control_plane.py compares."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Happened:
    """An event of the manager; ``at`` in seconds since 1970."""

    n: int
    at: float
    kind: str
    words: str
