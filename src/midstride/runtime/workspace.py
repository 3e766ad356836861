"""The workspace of a running system: the files that its next manager needs (socket, state, logs, lock).

``$XDG_RUNTIME_DIR/midstride/<system>``, a folder only its user can open. The control sockets of its components are in
a folder below it (:mod:`midstride.wire.sockets`); the state is that of
:mod:`.records.state_store`, and the journal that of :mod:`.records.journal`.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from midstride.errors import ManagerBusy, ManagerError
from midstride.wire.folders import COMPONENTS, workspace_folder, workspace_root

# The free disk space that a manager needs to start (bytes): a small state and the first lines of logs.
ROOM: Final = 16_384
_LONGEST_SOCKET: Final = 107  # bytes, on Linux


@dataclass(frozen=True, slots=True)
class Workspace:
    """The folder of one running system."""

    path: Path

    @classmethod
    def of(cls, system: str) -> Workspace:
        """The workspace of ``system``, created if necessary. Raises ManagerError if it cannot be private."""
        path = workspace_folder(system)
        if (over := len(os.fsencode(cls(path).socket)) - _LONGEST_SOCKET) > 0:
            raise ManagerError(
                f"{cls(path).socket} is {over} bytes too long for a socket: shorten the name of the system, "
                "or set XDG_RUNTIME_DIR to a folder with a shorter path"
            )
        return cls(path)

    @classmethod
    def all(cls) -> list[Workspace]:
        """The workspaces of every system of this user that has been brought up and not down.

        A system whose manager runs is included even if its state has been deleted.
        """
        return [space for space in cls._known() if space._is_up()]

    @classmethod
    def down(cls) -> list[Workspace]:
        """The workspaces of the others that have left their journal: of systems that are down."""
        return [space for space in cls._known() if space.journal.exists() and not space._is_up()]

    @classmethod
    def _known(cls) -> list[Workspace]:
        root = workspace_root()
        return [cls(folder) for folder in sorted(root.iterdir())] if root.is_dir() else []

    def _is_up(self) -> bool:
        return self.state.exists() or self.manager() is not None

    @property
    def name(self) -> str:
        return self.path.name

    @property
    def socket(self) -> Path:
        return self.path / "manager.sock"

    @property
    def state(self) -> Path:
        return self.path / "state.db"

    @property
    def journal(self) -> Path:
        return self.path / "journal.db"

    @property
    def components(self) -> Path:
        """The folder of the components' control sockets."""
        return self.path / COMPONENTS

    @property
    def logs(self) -> Path:
        folder = self.path / "logs"
        folder.mkdir(mode=0o700, exist_ok=True)
        return folder

    @property
    def manager_log(self) -> Path:
        return self.logs / "manager.log"

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Held while a manager runs; the kernel frees it however that manager ends. Raises ManagerBusy.

        Meanwhile systemd-tmpfiles leaves the folder alone: in the temporary folder, it would remove what has not been
        used for ten days, as the state of a system that is not changed (tmpfiles.d(5), *Age*).
        """
        handle = os.open(self.path / "lock", os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o600)
        folder = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                holder = os.read(handle, 64).decode(errors="replace").strip() or "unknown"
                raise ManagerBusy(f"a manager of {self.name} is running already (process {holder})") from None
            with suppress(OSError):  # on a full disk the lock works too, without the number of its holder
                os.ftruncate(handle, 0)
                os.write(handle, str(os.getpid()).encode())
            with suppress(OSError):  # someone else has it: that keeps the folder as well
                fcntl.flock(folder, fcntl.LOCK_SH | fcntl.LOCK_NB)
            yield
        finally:
            os.close(handle)
            os.close(folder)

    def manager(self) -> int | None:
        """The process number of the running manager, whether it responds or not; None if none runs."""
        try:
            with (self.path / "lock").open() as lock:
                pid = int(lock.read())
                if b"_manager" not in Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0"):
                    return None
                fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)  # free if the manager is about to exit
                return None
        except BlockingIOError:
            return pid
        except (OSError, ValueError):
            return None

    def write_private(self, name: str, text: str) -> Path:
        """A new file in place of any of that name, which only this user can read."""
        path = self.path / name
        path.unlink(missing_ok=True)
        handle = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600)
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        return path

    def require_room(self) -> None:
        """Raises ManagerError if nothing can be written here: a manager could not even log why it exits."""
        trial = self.path / "trial"
        try:
            with trial.open("wb") as file:
                file.write(bytes(ROOM))
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise ManagerError(f"cannot write to {self.path}: {error.strerror or error}") from None
        finally:
            with suppress(OSError):
                trial.unlink(missing_ok=True)
