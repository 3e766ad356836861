"""The model's QoS as rclpy's."""

from __future__ import annotations

from typing import Any

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy

from midstride.model.contract import QoS


def profile(qos: QoS) -> Any:
    """The profile of a real endpoint: what is not stated is ROS 2's default (semantics.md section 1)."""
    stated = qos.effective()
    result = QoSProfile(
        history=HistoryPolicy.KEEP_ALL if stated.history == "keep_all" else HistoryPolicy.KEEP_LAST,
        depth=stated.depth,
        reliability=ReliabilityPolicy.RELIABLE if stated.is_reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if stated.is_transient_local else DurabilityPolicy.VOLATILE,
        liveliness=LivelinessPolicy.MANUAL_BY_TOPIC
        if stated.liveliness == "manual_by_topic"
        else LivelinessPolicy.AUTOMATIC,
    )
    if stated.deadline is not None:
        result.deadline = Duration(nanoseconds=round(stated.deadline * 1e9))
    if stated.lease is not None:
        result.liveliness_lease_duration = Duration(nanoseconds=round(stated.lease * 1e9))
    if stated.lifespan is not None:
        result.lifespan = Duration(nanoseconds=round(stated.lifespan * 1e9))
    return result
