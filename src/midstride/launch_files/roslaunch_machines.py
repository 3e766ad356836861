"""The machines of launch files of ROS 1, as hosts of a specification."""

from __future__ import annotations

import getpass
import ipaddress
import os
import re
import socket
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

from midstride.lang.source import Span
from midstride.lang.token_stream import RESERVED
from midstride.launch_files.element_attributes import MAX_NAME
from midstride.launch_files.findings import ImportFindings, UnknownValue
from midstride.launch_files.roslaunch_grammar import refused
from midstride.model.hosts import MANAGER, HostSpec

SSH_PORT: Final = 22
_NOT_IN_NAMES: Final = re.compile(r"[^A-Za-z0-9_]+")
_DESTINATION: Final = re.compile(r"[^\s-]\S*")
_CATKIN: Final = re.compile(r"/(?:\S+/)?env\.sh")
_SOURCED: Final = re.compile(r"(?:source|\.)\s+(['\"]?)(/[^\s'\"$;&|]+)\1")
_EXPORTED: Final = re.compile(r"export\s+([A-Za-z_]\w*)=[^;&|]*")
_RUNS: Final = re.compile(r"exec\s+(\"\$@\"|\$@)")


@dataclass(frozen=True, slots=True)
class Machine:
    """A computer of a launch file. ``loader``: the script there that sets the environment and runs its arguments.

    A password is not kept.
    """

    name: str
    address: str
    user: str
    loader: str | None
    port: int

    @property
    def is_own(self) -> bool:
        """Return whether it is this computer, for the user who imports; another user is reached by `ssh`."""
        return _is_own(self.address) and self.user in {"", getpass.getuser()}


class Machines:
    """The machines by name, and the ``hosts`` that those become on which nodes run.

    ``read`` returns the text of a file, or raises UnknownValue where an import may not read it.
    """

    def __init__(self, findings: ImportFindings, environment: Mapping[str, str], read: Callable[[str], str]) -> None:
        self._findings = findings
        self._environment = environment
        self._read = read
        self._machines: dict[str, tuple[Machine, Span]] = {}
        self._names: dict[Machine, str] = {}
        self.hosts: dict[str, HostSpec] = {}

    def declare(self, machine: Machine, span: Span) -> None:
        """Raises UnknownValue for a second one of that name, unless they are the same."""
        known, _ = self._machines.setdefault(machine.name, (machine, span))
        if known != machine:
            raise refused(f"another machine is named `{machine.name}`")

    def host_of(self, name: str, span: Span) -> str:
        """The host of a node that is to run on the machine ``name``; empty for that of the manager."""
        if not name:
            return ""
        if name not in self._machines:
            self._findings.refuse(f"there is no machine `{name}`; the node is on the manager's host", span)
            return ""
        machine, declared = self._machines[name]
        alike = replace(machine, name="")  # machines that differ in nothing else are one host
        if alike not in self._names:
            try:
                self._names[alike] = "" if machine.is_own else self._host(machine, declared)
            except UnknownValue as error:
                self._names[alike] = ""
                self._findings.leave_out(f"the machine `{name}`", error, declared)
        return self._names[alike]

    def _host(self, machine: Machine, span: Span) -> str:
        """The name of the host that a machine becomes. Raises UnknownValue."""
        destination = f"{machine.user}@{machine.address}" if machine.user else machine.address
        if not _DESTINATION.fullmatch(destination) or not destination.isprintable():
            raise UnknownValue(f"`{destination}` is no destination of `ssh`", "host")
        name = _NOT_IN_NAMES.sub("_", machine.name).strip("_")[:MAX_NAME] or "host"
        name = name if name[0].isalpha() else f"host_{name}"
        while name in RESERVED or name == MANAGER or name in self.hosts:
            name = f"{name}_1"
        message = "machines become hosts: plans show them, and `up --backend ros1` refuses hosts besides the manager's"
        self._findings.add_once("host", message, span)
        if name != machine.name:
            self._findings.add("name", f"the machine `{machine.name}` is named `{name}`", span, left_out=False)
        if machine.port != SSH_PORT:
            message = f"the port {machine.port} of `{machine.name}` is left out: state it for {machine.address} in "
            self._findings.add("host", f"{message}~/.ssh/config", span)
        self.hosts[name] = HostSpec(name, destination, self._setup(machine, span))
        return name

    def _setup(self, machine: Machine, span: Span) -> str | None:
        """The file that a shell sources to have the environment of a machine, where it is known or can be assumed."""
        loader = machine.loader
        if loader is None:
            if self._environment.get("ROS_VERSION") != "1":
                message = f"`{machine.name}` has no `env-loader`: roslaunch would use its own; state `setup`"
                self._findings.add("host", message, span)
                return None
            loader = f"/opt/ros/{self._environment.get('ROS_DISTRO', '')}/env.sh"
        try:
            lines = self._read(loader).splitlines()
        except UnknownValue:
            lines = None
        beside = os.path.join(os.path.dirname(loader), "setup.bash")
        if lines is None and _CATKIN.fullmatch(loader) and loader.isprintable():
            message = f"`{loader}` is taken for catkin's: `setup` is the file beside it; it may set more on the host"
            self._findings.add("host", message, span, left_out=False)
            return beside
        if lines is not None and any("_CATKIN_SETUP_DIR" in line for line in lines):
            return beside
        return self._sourced(loader, lines or [], span)

    def _sourced(self, loader: str, lines: list[str], span: Span) -> str | None:
        """The one file that a script sources; what else it does is named. None where that is more than variables."""
        code = [line.strip() for line in lines if line.strip() and not line.strip().startswith("#")]
        sourced = [match[2] for line in code if (match := _SOURCED.fullmatch(line))]
        exported = [match[1] for line in code if (match := _EXPORTED.fullmatch(line))]
        known = len(sourced) + len(exported) + sum(_RUNS.fullmatch(line) is not None for line in code)
        if len(sourced) != 1 or known != len(code):
            message = f"what `env-loader` `{loader}` sets is left out: write a file there that sets it without running "
            self._findings.add("host", f"{message}anything, and state that as `setup`", span)
            return None
        if exported:
            names = ", ".join(f"`{name}`" for name in exported)
            message = f"`setup` is what `{loader}` sources; {names}, which it sets besides, is left out"
            self._findings.add("host", message, span)
        return sourced[0]


def _is_own(address: str) -> bool:
    if address == "localhost" or address == socket.gethostname():
        return True
    try:
        parsed = ipaddress.ip_address(address)
        if parsed.is_loopback:
            return True
        with socket.socket(socket.AF_INET6 if parsed.version == 6 else socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind((address, 0))  # only an address of this computer can be
    except (OSError, ValueError):
        return False
    return True
