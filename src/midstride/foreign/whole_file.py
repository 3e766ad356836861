"""Files of the folder of gates, which other processes and later managers read: each is whole, or not there."""

from __future__ import annotations

from pathlib import Path

from midstride.errors import BackendError


def write_whole(path: Path, content: bytes) -> None:
    """Replace a file in one step. Raises BackendError."""
    try:
        new = path.with_suffix(".new")
        new.write_bytes(content)
        new.replace(path)
    except OSError as error:
        raise BackendError(f"{path} cannot be written: {error.strerror or error}") from None
