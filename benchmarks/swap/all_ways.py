"""All ways, in the order of the plots. A new one is added here."""

from __future__ import annotations

from .containers import ComposedHandover, Loading, ManagedComponents
from .dora import NodeReplace
from .handovers import Gated, Handover, OnRclcpp, Paper
from .ways import KillAndStart, Lifecycle, Nothing, Respawn, StartAndKill, Way

WAYS: list[Way] = [
    Nothing(),
    Handover(),
    Gated("preload", "Midstride, without its API: rclpy, `gate preload`"),
    Gated("relay", "Midstride, without its API: rclpy, `gate relay`"),
    OnRclcpp(),
    ComposedHandover(),
    Lifecycle(),
    ManagedComponents(),
    Loading(),
    NodeReplace(),
    KillAndStart(),
    Respawn(),
    StartAndKill(),
    Paper(),
]
