"""The lease of a component's outputs, which have a fallback on another host (docs/protocols/lease.md)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(eq=False, slots=True)
class WriteLease:
    """A lease until ``until`` (steady, ns): up to then, what is written passes; without one (None), all passes.

    The control thread sets it, and the data thread reads it at each write.
    """

    steady: Callable[[], int]
    until: int | None = None

    @property
    def is_over(self) -> bool:
        return self.until is not None and self.steady() >= self.until
