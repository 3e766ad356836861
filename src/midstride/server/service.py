"""Who answers: the manager's identity, as `GET /api/v1` reports it."""

from __future__ import annotations

from typing import Literal, TypeAlias

from midstride.runtime.reports import Report

Phase: TypeAlias = Literal["starting", "up", "failed", "down"]


class Service(Report, frozen=True):
    """The manager that answers, and whether its system is up."""

    system: str
    backend: str
    version: str
    pid: int
    phase: Phase
