"""The text of a message: who wrote it, its number, when it was written, and padding. Needs nothing but Python."""

from __future__ import annotations

import os
import time
from collections.abc import Callable

# A reader needs no more than the beginning.
HEAD = 120


def unique(name: str) -> str:
    """A talker's name that no other talker has, nor an earlier one of this name."""
    return f"{name}-{os.getpid()}-{time.monotonic_ns()}"


def counted(name: str, size: int) -> Callable[[], str]:
    """A function that returns a talker's next message: ``size`` characters, or the few more that its head needs."""
    talker, padding, number = unique(name), " " + "x" * size, 0

    def following() -> str:
        nonlocal number
        number += 1
        head = f"{talker} {number} {time.monotonic_ns()}"
        return head + padding[: max(1, size - len(head))]

    return following


def read(text: bytes) -> tuple[int, int, str]:
    """When a message was written (steady ns), its number, and its talker. Raises ValueError."""
    talker, number, sent = text[:HEAD].split(b" ", 3)[:3]
    return int(sent), int(number), talker.decode()
