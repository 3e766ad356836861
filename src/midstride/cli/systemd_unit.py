"""The text of a systemd unit that keeps a system up."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from midstride.errors import MidstrideError

# The exit statuses of `up --foreground` after which another attempt is of no use: a wrong option, and EX_CONFIG.
OF_NO_USE: Final = (2, 78)
# The variables that decide which ROS the nodes have, which middleware, and whom they find.
_KEPT: Final = re.compile(
    r"PATH|PYTHONPATH|LD_LIBRARY_PATH|VIRTUAL_ENV|CMAKE_PREFIX_PATH|PKG_CONFIG_PATH|CYCLONEDDS_URI|"
    r"(ROS|RMW|RCL|RCUTILS|AMENT|COLCON|CATKIN|FASTRTPS|FASTDDS|CYCLONEDDS|ZENOH|ROSCONSOLE|GZ|GAZEBO)_\w+|"
    r"MIDSTRIDE_(INCLUDE_PATH|ALLOY|ROS1_\w+|\w+_TIMEOUT)"
)
# Those that a `setup.bash` sets.
_OF_SETUP: Final = re.compile(
    r"PATH|PYTHONPATH|LD_LIBRARY_PATH|CMAKE_PREFIX_PATH|PKG_CONFIG_PATH|(AMENT|COLCON)_\w+|"
    r"ROS_(DISTRO|VERSION|PYTHON_VERSION|ROOT|PACKAGE_PATH|ETC_DIR)"
)


@dataclass(frozen=True, slots=True)
class Unit:
    """The contents of the unit of one system.

    ``command`` runs `midstride`, and ``up`` are the arguments after `up`. ``setup``: scripts that Bash reads first.
    ``user`` is None for a unit of a user's own systemd; ``runtime`` is the folder in XDG_RUNTIME_DIR there.
    ``limits``: the directives of the process limits that are to be as they are here.
    """

    system: str
    file: Path
    command: Sequence[str]
    up: Sequence[str]
    environment: Mapping[str, str]
    setup: Sequence[Path] = ()
    user: str | None = None
    uid: int = 0
    runtime: str = ""
    limits: Mapping[str, str] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return f"midstride-{self.system}.service"

    def text(self) -> str:
        """The unit. Raises MidstrideError where a value cannot be written in one."""
        return "\n".join([*self._unit(), "", *self._service(), "", *self._install(), ""])

    def _unit(self) -> list[str]:
        lines = ["[Unit]", f"Description=The robot {self.system}, kept up by Midstride"]
        if self.user is not None:
            lines += [
                "Wants=network-online.target",
                "After=network-online.target",
                f"RequiresMountsFor={_word(str(self.file))}",
            ]
            if self.runtime == user_runtime(self.uid):
                folder = f"user-runtime-dir@{self.uid}.service"
                lines += [
                    "# The folder of the user's run-time files, where every shell of theirs looks.",
                    f"Wants={folder}",
                ]
                lines += [f"After={folder}"]
        # A robot comes back however often its manager has ended.
        return [*lines, "StartLimitIntervalSec=0"]

    def _service(self) -> list[str]:
        system = ["--system", self.system]
        lines = ["[Service]", "Type=notify"]
        if self.user is not None:
            lines += [f"User={_text(self.user)}"]
        lines += [f"WorkingDirectory={_text(str(self.file.parent))}"]
        if self.user is not None:
            lines += [f"Environment={_word(f'XDG_RUNTIME_DIR={self.runtime}', dollar=False)}"]
        lines += [f"Environment={_word(f'{name}={value}', dollar=False)}" for name, value in self._kept().items()]
        lines += [
            f"ExecStart={self._run('up', *self.up, '--foreground', '--take-over', self.system)}",
            f"ExecReload={self._run('apply', str(self.file), '--yes', *system)}",
            f"ExecStop={self._run('down', *system)}",
            "# A manager that has died comes back and takes over its components, which go on meanwhile.",
            "Restart=on-failure",
            "RestartSec=1",
            f"RestartPreventExitStatus={' '.join(map(str, OF_NO_USE))}",
            "KillMode=process",
            "OOMPolicy=continue",
            "WatchdogSec=30",
            "# Starting, changing and stopping may take longer: the manager asks for more time.",
            "TimeoutStartSec=90",
            "TimeoutStopSec=90",
        ]
        return [*lines, *(f"{name}={value}" for name, value in self.limits.items())]

    def _install(self) -> list[str]:
        return ["[Install]", f"WantedBy={'default' if self.user is None else 'multi-user'}.target"]

    def _kept(self) -> dict[str, str]:
        return {
            name: value
            for name, value in sorted(self.environment.items())
            if _KEPT.fullmatch(name) and not (self.setup and _OF_SETUP.fullmatch(name))
        }

    def _run(self, *words: str) -> str:
        command = [*self.command, *words]
        if self.setup:
            read = " && ".join(f"source {shlex.quote(str(script))}" for script in self.setup)
            command = ["/bin/bash", "-c", f'{read} && exec "$@"', "bash", *command]
        return " ".join(map(_word, command))


def user_runtime(uid: int) -> str:
    """The folder of the run-time files of a user, where systemd makes it."""
    return f"/run/user/{uid}"


def _text(value: str) -> str:
    """A value that is read to the end of its line. Raises MidstrideError where it does not fit on one."""
    if "\n" in value or value != value.strip():
        raise MidstrideError(f"{value!r} cannot be written in a unit: rename it")
    return value.replace("%", "%%")


def _word(value: str, *, dollar: bool = True) -> str:
    """One word of a command or a list, as systemd.syntax(7) quotes it; ``dollar``: where variables are replaced."""
    for character, escaped in (("\\", "\\\\"), ('"', '\\"'), ("\n", "\\n"), ("%", "%%")):
        value = value.replace(character, escaped)
    if dollar:
        value = value.replace("$", "$$")
    return value if re.fullmatch(r"[\w@%+=:,./\-]+", value, re.ASCII) else f'"{value}"'
