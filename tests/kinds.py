"""Contracts of services and ROS actions that are to each other as contracts of messages are.

What is a rate of messages is a bound on requests: a rate must be no lower, a bound no longer, so a bound is one period.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from midstride.model.contract import ConnectorKind, Predicate

KINDS: Final[tuple[ConnectorKind, ...]] = ("topic", "service", "action")
_FOLDERS: Final[dict[ConnectorKind, str]] = {"topic": "msg", "service": "srv", "action": "action"}


def of_kind(predicate: Predicate, kind: ConnectorKind) -> Predicate:
    """That contract of messages for another kind of connector; requests have no QoS and no fields."""
    package, _, name = predicate.type.split("/")
    if kind == "topic":
        return predicate
    return with_rate(Predicate(f"{package}/{_FOLDERS[kind]}/{name}"), predicate.rate)


def with_rate(predicate: Predicate, rate: float | None) -> Predicate:
    """With that rate (Hz) of messages, or with its period (s) as the bound on requests; None: with neither."""
    if predicate.kind == "topic":
        return replace(predicate, rate=rate)
    return replace(predicate, within=None if rate is None else 1 / rate)


def rate_of(predicate: Predicate) -> float | None:
    """The rate (Hz) with which :func:`with_rate` makes that contract."""
    if predicate.kind == "topic":
        return predicate.rate
    return None if predicate.within is None else 1 / predicate.within
