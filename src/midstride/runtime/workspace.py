"""Where a running system keeps what its next manager needs: socket, state, logs, lock.

``$XDG_RUNTIME_DIR/midstride/<system>`` (interfaces.md, HTTP), a folder only its user can open. The
state file is written whole and renamed into place, so a manager killed at any moment leaves the
old state or the new one, never half of one.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from midstride.errors import ManagerBusy, ManagerError

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_\-]*\Z")


def _root() -> Path:
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime:
        return Path(runtime) / "midstride"
    return Path(tempfile.gettempdir()) / f"midstride-{os.getuid()}"


@dataclass(frozen=True, slots=True)
class Workspace:
    """The folder of one running system."""

    path: Path

    @classmethod
    def of(cls, system: str) -> Workspace:
        """The workspace of ``system``, made if need be. Raises ManagerError where it cannot be private."""
        if not _NAME.match(system):
            raise ManagerError(f"{system!r} cannot name a running system: use letters, digits, _ and -")
        root = _root()
        for folder in (root, root / system):
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            info = folder.stat()
            if info.st_uid != os.getuid():
                raise ManagerError(f"{folder} belongs to another user; remove it or set XDG_RUNTIME_DIR")
            if stat.S_IMODE(info.st_mode) != 0o700:
                folder.chmod(0o700)
        return cls(root / system)

    @classmethod
    def all(cls) -> list[Workspace]:
        """The workspaces of every system of this user that has been brought up and not down."""
        root = _root()
        if not root.is_dir():
            return []
        return [cls(folder) for folder in sorted(root.iterdir()) if (folder / "state.json").exists()]

    @property
    def name(self) -> str:
        return self.path.name

    @property
    def socket(self) -> Path:
        return self.path / "manager.sock"

    @property
    def state(self) -> Path:
        return self.path / "state.json"

    @property
    def logs(self) -> Path:
        folder = self.path / "logs"
        folder.mkdir(mode=0o700, exist_ok=True)
        return folder

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Held while a manager runs; the kernel frees it however that manager ends. Raises ManagerBusy."""
        handle = os.open(self.path / "lock", os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o600)
        try:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                holder = os.read(handle, 64).decode(errors="replace").strip() or "unknown"
                raise ManagerBusy(f"a manager of {self.name} is running already (process {holder})") from None
            os.ftruncate(handle, 0)
            os.write(handle, str(os.getpid()).encode())
            yield
        finally:
            os.close(handle)

    def save(self, document: dict[str, Any]) -> None:
        """Keep ``document`` as the state. Raises ManagerError where the disk refuses; the old state then stands."""
        partial = self.path / "state.json.new"
        try:
            with partial.open("w", encoding="utf-8") as file:
                json.dump(document, file)
                file.flush()
                os.fsync(file.fileno())
            partial.replace(self.state)
        except OSError as error:
            partial.unlink(missing_ok=True)
            raise ManagerError(f"cannot write {self.state}: {error.strerror or error}") from error

    def load(self) -> dict[str, Any] | None:
        """The state an earlier manager left, or None. Raises ManagerError where it cannot be read."""
        try:
            document = json.loads(self.state.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return None
        except (OSError, ValueError) as error:
            raise ManagerError(f"cannot read {self.state}: {error}; `midstride down` ends what still runs") from error
        if not isinstance(document, dict):
            raise ManagerError(f"cannot read {self.state}: not a state; `midstride down` ends what still runs")
        return document

    def forget(self) -> None:
        """The system is down: its state goes; its logs stay until the next start, its socket until its manager ends."""
        self.state.unlink(missing_ok=True)
