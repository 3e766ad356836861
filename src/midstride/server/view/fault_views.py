"""The crashes and silences of the live view."""

from __future__ import annotations

from midstride.model.configuration import Configuration
from midstride.runtime.view import status
from midstride.runtime.view.watched_system import WatchedSystem
from midstride.server.view.view_forms import CrashView, SilenceView


def crash_views(watched: WatchedSystem) -> list[CrashView]:
    """The instances that exited unexpectedly, and what becomes of them."""
    return [
        CrashView(
            name=each.name,
            role=each.role,
            status=each.status,
            log=each.log,
            remedy=each.remedy,
            respawn=None if each.respawn is None else each.respawn.words,
        )
        for each in status.crashed(watched)
    ]


def silence_views(watched: WatchedSystem, configuration: Configuration) -> list[SilenceView]:
    """What is silent now."""
    return [
        SilenceView(kind=each.kind, instance=each.instance, port=each.port, topic=each.topic, words=each.words)
        for each in watched.monitor.faults(configuration)
    ]
