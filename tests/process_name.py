"""The name of this process, as the kernel shows it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_NAME = Path("/proc/self/comm")


@contextmanager
def named(name: str) -> Iterator[None]:
    """Meanwhile this process has that name, of which the kernel keeps 15 bytes: the last one may be half a letter."""
    own = _NAME.read_bytes().rstrip(b"\n")
    _NAME.write_bytes(name.encode())
    try:
        yield
    finally:
        _NAME.write_bytes(own)
