"""Files of the folder of gates, which other processes and later managers read: each is whole, or not there."""

from __future__ import annotations

from pathlib import Path

from midstride.errors import BackendError
from midstride.whole_file import write_whole


def write_gate_file(path: Path, content: bytes) -> None:
    """Replace a file in one step. Raises BackendError."""
    try:
        write_whole(path, content)
    except OSError as error:
        raise BackendError(f"{path} cannot be written: {error.strerror or error}") from None
