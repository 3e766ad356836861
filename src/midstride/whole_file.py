"""Files that others read meanwhile: each is replaced in one step, so it is whole, old or new, or not there."""

from __future__ import annotations

import os
import secrets
import stat
from contextlib import suppress
from pathlib import Path


def write_whole(path: Path, content: bytes, *, mode: int | None = None) -> None:
    """Replace a file in one step, through links. Raises OSError; the file is then as before.

    ``mode`` are its permissions: without it, those that the file has, or those that the umask gives to a new one.
    """
    target = path.resolve()
    new = target.with_name(f".midstride-{secrets.token_hex(8)}")  # a longer name may not fit
    try:
        with new.open("xb") as file:
            file.write(content)
            if mode is None:
                with suppress(FileNotFoundError):
                    mode = stat.S_IMODE(target.stat().st_mode)
            if mode is not None:
                os.fchmod(file.fileno(), mode)
        new.replace(target)
    except BaseException:
        with suppress(OSError):
            new.unlink()
        raise
