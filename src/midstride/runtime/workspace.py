"""The workspace of a running system: the files that its next manager needs (socket, state, logs, lock).

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
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import psutil

from midstride.errors import ManagerBusy, ManagerError

# The form of the state; whoever reads another one says so.
VERSION: Final = 1
# What must fit on the disk before a manager is started (bytes): a small state, and the first lines of the logs.
_ROOM: Final = 16_384
_LONGEST_SOCKET: Final = 107  # bytes, on Linux
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
        if (over := len(os.fsencode(cls(root / system).socket)) - _LONGEST_SOCKET) > 0:
            raise ManagerError(
                f"{cls(root / system).socket} is {over} bytes too long for a socket: shorten the name of the system, "
                "or set XDG_RUNTIME_DIR to a folder with a shorter path"
            )
        for folder in (root, root / system):
            try:
                folder.mkdir(mode=0o700, parents=True, exist_ok=True)
                info = folder.stat()
            except OSError as error:
                raise ManagerError(
                    f"cannot make the folder {folder}, for socket, state and logs: {error.strerror or error}; "
                    "set XDG_RUNTIME_DIR to a folder of yours"
                ) from None
            if info.st_uid != os.getuid():
                raise ManagerError(f"{folder} belongs to another user; remove it or set XDG_RUNTIME_DIR")
            if stat.S_IMODE(info.st_mode) != 0o700:
                folder.chmod(0o700)
        return cls(root / system)

    @classmethod
    def all(cls) -> list[Workspace]:
        """The workspaces of every system of this user that has been brought up and not down.

        One whose manager runs is among them even where somebody has cleaned up, and its state is gone.
        """
        root = _root()
        if not root.is_dir():
            return []
        found = [cls(folder) for folder in sorted(root.iterdir())]
        return [space for space in found if space.state.exists() or space.manager() is not None]

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
            with suppress(OSError):  # on a full disk the lock holds as well; it only does not say whose it is
                os.ftruncate(handle, 0)
                os.write(handle, str(os.getpid()).encode())
            yield
        finally:
            os.close(handle)

    def manager(self) -> int | None:
        """The process of the manager that runs, whether it answers or not; None where none does."""
        try:
            with (self.path / "lock").open() as lock:
                pid = int(lock.read())
                if "_manager" not in psutil.Process(pid).cmdline():
                    return None
                fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)  # one that is about to end has let go of it
                return None
        except BlockingIOError:
            return pid
        except (OSError, ValueError, psutil.Error):
            return None

    def require_room(self) -> None:
        """Raises ManagerError where nothing can be written here: a manager could not even say why it ends."""
        trial = self.path / "trial"
        try:
            with trial.open("wb") as file:
                file.write(bytes(_ROOM))
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise ManagerError(f"cannot write to {self.path}: {error.strerror or error}") from None
        finally:
            with suppress(OSError):
                trial.unlink(missing_ok=True)

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
            raise self._unreadable(str(error)) from error
        if not _is_state(document):
            raise self._unreadable("no manager of this version has written it")
        return dict(document)

    def _unreadable(self, why: str) -> ManagerError:
        return ManagerError(
            f"cannot read {self.state}: {why}. So it is not known what still runs of {self.name}: end that yourself, "
            "then remove the file"
        )

    def forget(self) -> None:
        """The system is down: its state goes; its logs stay until the next start, its socket until its manager ends."""
        self.state.unlink(missing_ok=True)


def _is_state(document: object) -> bool:
    """Whether it has the form that ``down`` and the next manager rely on; runtime/adoption.py says what is in it."""
    if not isinstance(document, dict) or document.get("version") != VERSION:
        return False
    entries = document.get("instances")
    return isinstance(entries, list) and all(
        isinstance(entry, dict) and isinstance(entry.get("handle", 0), (dict, type(None))) for entry in entries
    )
