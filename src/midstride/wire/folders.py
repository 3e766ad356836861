"""The folders of running systems. Shell completion imports this, so it imports neither asyncio nor the forms."""

from __future__ import annotations

import os
import re
import stat
import tempfile
from pathlib import Path
from typing import Final

from midstride.errors import ManagerError

# The folder of the control sockets in a workspace.
COMPONENTS: Final = "components"
_SYSTEM: Final = re.compile(r"[A-Za-z][A-Za-z0-9_\-]*\Z")


def workspace_root() -> Path:
    """The folder of all workspaces of this user: ``$XDG_RUNTIME_DIR/midstride``, else one in the temporary folder."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime:
        return Path(runtime) / "midstride"
    return Path(tempfile.gettempdir()) / f"midstride-{os.getuid()}"


def workspace_folder(system: str) -> Path:
    """The workspace of ``system``, created if need be.

    Raises ManagerError where ``system`` is not a name, or where the folder cannot be created or is another user's.
    """
    if not _SYSTEM.match(system):
        raise ManagerError(f"{system!r} cannot name a running system: use letters, digits, _ and -")
    root = workspace_root()
    for folder in (root, root / system):
        try:
            created = not folder.exists()
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            info = folder.stat()
            if created or (info.st_uid == os.getuid() and stat.S_IMODE(info.st_mode) & 0o007):
                folder.chmod(0o700)
        except OSError as error:
            raise ManagerError(
                f"cannot create the folder {folder}, for sockets, state and logs: {error.strerror or error}; "
                "set XDG_RUNTIME_DIR to a folder of yours"
            ) from None
        if info.st_uid != os.getuid() and not _is_shared(info):
            raise ManagerError(f"{folder} belongs to another user; remove it or set XDG_RUNTIME_DIR")
    return root / system


def _is_shared(info: os.stat_result) -> bool:
    """Return whether another user's folder is meant for this one, which has then named it, and not for everyone."""
    return bool(os.environ.get("XDG_RUNTIME_DIR")) and stat.S_IMODE(info.st_mode) & 0o022 == 0o020
