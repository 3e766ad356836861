"""Robots on one machine: each a network namespace with an SSH server, and a system of real ROS 2 nodes in a domain.

The computer of the operator is a namespace as well, with a bridge to which all of them are connected. They share the
machine's files, clock and processors. Nothing of the machine's own SSH or Ansible settings is used.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.hosts.two_hosts import CABLE, SSHD, traffic

ROOT = Path(__file__).parents[2]
TALKER = ROOT / "examples" / "talker" / "talker.stride"
NETWORK, BRIDGE = "10.212.77", "bridge"
# As the page on fleets has it: a cut is noticed after a few seconds.
KEPT_ALIVE = "-o ServerAliveInterval=2 -o ServerAliveCountMax=2"
# How long processes of a namespace may take to end after SIGTERM (s).
GRACE = 5.0


@dataclass(frozen=True)
class Robot:
    number: int
    namespace: str
    folder: Path
    environment: dict[str, str]

    @property
    def name(self) -> str:
        return f"r{self.number}"

    def run(self, *words: str) -> str:
        """What a command of ``midstride`` prints on this robot."""
        command = ["nsenter", f"--net=/run/netns/{self.namespace}", sys.executable, "-m", "midstride", *words]
        done = subprocess.run(command, env=self.environment, capture_output=True, text=True, cwd=ROOT, check=False)
        assert done.returncode == 0, f"{self.name}: {done.stdout}{done.stderr}"
        return done.stdout

    def talker(self) -> str:
        """The component that talks on this robot."""
        instances = json.loads(self.run("status", "--json"))["instances"]
        return next(str(each["component"]) for each in instances if each["role"] == "talker")

    def changes(self) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = json.loads(self.run("history", "--json"))["changes"]
        return found

    def traffic(self) -> int:
        """The bytes that went over its network interface so far, both ways, with the headers of Ethernet."""
        return traffic(self.namespace)


@dataclass
class Fleet:
    """``folder``: of all that belongs to the robots, with a short path. ``domains``: the ROS domain of each."""

    folder: Path
    domains: Sequence[int]
    operator: str = field(default_factory=lambda: f"midstride-{os.getpid()}-operator")
    robots: list[Robot] = field(default_factory=list)
    servers: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)

    def make(self) -> None:
        _ip("netns", "add", self.operator)
        _ip("-n", self.operator, "link", "add", BRIDGE, "type", "bridge")
        _ip("-n", self.operator, "address", "add", f"{NETWORK}.254/24", "dev", BRIDGE)
        for device in ("lo", BRIDGE):
            _ip("-n", self.operator, "link", "set", device, "up")
        for key in ("host_key", "user_key"):
            subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", self.folder / key], check=True)
        Path("/run/sshd").mkdir(exist_ok=True)
        setup = self.folder / "setup.bash"
        setup.write_text(f'export PATH="{Path(sys.executable).parent}:$PATH"\n')
        for number, domain in enumerate(self.domains, start=1):
            self._add(number, domain)
        public = " ".join((self.folder / "host_key.pub").read_text().split()[:2])
        known = self.folder / "known_hosts"
        known.write_text("".join(f"{NETWORK}.{robot.number} {public}\n" for robot in self.robots))
        lines = [self._inventory(robot) for robot in self.robots]
        lines += ["", "[all:vars]", f"ansible_ssh_private_key_file={self.folder}/user_key", "ansible_user=root"]
        lines += [f"ansible_ssh_common_args=-F none -o IdentitiesOnly=yes -o UserKnownHostsFile={known} {KEPT_ALIVE}"]
        lines += [f"ansible_python_interpreter={sys.base_prefix}/bin/python3", f"midstride_setup=['{setup}']"]
        (self.folder / "robots.ini").write_text("\n".join(lines) + "\n")

    def _add(self, number: int, domain: int) -> None:
        name = f"midstride-{os.getpid()}-r{number}"
        _ip("netns", "add", name)
        _ip("-n", self.operator, "link", "add", f"r{number}", "type", "veth", "peer", "name", CABLE, "netns", name)
        _ip("-n", self.operator, "link", "set", f"r{number}", "master", BRIDGE, "up")
        _ip("-n", name, "address", "add", f"{NETWORK}.{number}/24", "dev", CABLE)
        for device in ("lo", CABLE):
            _ip("-n", name, "link", "set", device, "up")
        folder = self.folder / f"r{number}"
        folder.mkdir()
        environment = {name: value for name, value in os.environ.items() if name not in ("RMW_IMPLEMENTATION",)}
        environment |= {"XDG_RUNTIME_DIR": str(folder), "ROS_DOMAIN_ID": str(domain)}
        environment |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_LOG_DIR": str(folder / "ros")}
        self.robots.append(Robot(number, name, folder, environment))
        self.serve(self.robots[-1])

    def _inventory(self, robot: Robot) -> str:
        """A line of the inventory."""
        environment = {key: robot.environment[key] for key in ("XDG_RUNTIME_DIR", "ROS_DOMAIN_ID", "ROS_LOG_DIR")}
        environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        temporary = f"ansible_remote_tmp={robot.folder}/tmp"
        return f'{robot.name} ansible_host={NETWORK}.{robot.number} {temporary} midstride_environment="{environment}"'

    def serve(self, robot: Robot) -> None:
        """Start the SSH server of a robot, and wait until it listens."""
        settings = robot.folder / "sshd_config"
        settings.write_text(
            f"ListenAddress {NETWORK}.{robot.number}\nHostKey {self.folder}/host_key\n"
            f"AuthorizedKeysFile {self.folder}/user_key.pub\nPidFile {robot.folder}/sshd.pid\n"
            "PasswordAuthentication no\nKbdInteractiveAuthentication no\nPermitRootLogin yes\n"
            "StrictModes no\nUsePAM no\nSubsystem sftp internal-sftp\n"
        )
        inside = ["nsenter", f"--net=/run/netns/{robot.namespace}"]
        words = [SSHD, "-D", "-E", str(robot.folder / "sshd.log"), "-f", str(settings)]
        self.servers[robot.name] = subprocess.Popen([*inside, *words])
        deadline = time.monotonic() + 10
        while ":0016 00000000:0000 0A" not in _output([*inside, "cat", "/proc/net/tcp"]):
            assert time.monotonic() < deadline, f"the SSH server of {robot.name} does not listen"
            time.sleep(0.02)

    def link(self, robot: Robot, state: str) -> None:
        """Have the cable of a robot ``up`` or ``down``."""
        _ip("-n", self.operator, "link", "set", robot.name, state)

    def up(self, file: Path = TALKER) -> None:
        """Bring up the system of each robot, one after another."""
        for robot in self.robots:
            robot.run("up", str(file), "--detach")

    def ansible(self, *words: str, environment: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
        """Run a command of Ansible on the computer of the operator, for all robots; ``words`` begin with its name."""
        home = {"ANSIBLE_HOME": str(self.folder / "a"), "ANSIBLE_NOCOLOR": "1", "ANSIBLE_RETRY_FILES_ENABLED": "0"}
        inside = ["nsenter", f"--net=/run/netns/{self.operator}", str(ROOT / "tools" / "ansible")]
        command = [*inside, words[0], "-i", str(self.folder / "robots.ini"), *words[1:]]
        given = {**os.environ, **home, **(environment or {})}
        return subprocess.run(command, env=given, cwd=self.folder, capture_output=True, text=True, check=False)

    def rollout(self, file: Path, *words: str, **variables: object) -> subprocess.CompletedProcess[str]:
        """Run the playbook of the collection. The reports of the robots are in the folder ``reports``."""
        (self.folder / "reports").mkdir(exist_ok=True)
        given = {"file": str(file), "reports": str(self.folder / "reports"), **variables}
        return self.ansible("ansible-playbook", "midstride.fleet.rollout", "-e", json.dumps(given), *words)

    def report(self, robot: Robot) -> dict[str, Any]:
        found: dict[str, Any] = json.loads((self.folder / "reports" / f"{robot.name}.json").read_text())
        return found

    def remove(self) -> None:
        """End what runs in the namespaces, in order, and remove them."""
        for robot in self.robots:
            for state in robot.folder.glob("midstride/*/state.db"):
                with contextlib.suppress(AssertionError):
                    robot.run("down", "--system", state.parent.name)
        namespaces = [self.operator, *(robot.namespace for robot in self.robots)]
        for namespace in namespaces:
            _end_all(namespace)
        for server in self.servers.values():
            server.wait()
        for namespace in namespaces:
            subprocess.run(["ip", "netns", "del", namespace], capture_output=True, check=False)


def _end_all(namespace: str) -> None:
    """End every process of a namespace, which has no others than those of this fleet."""
    deadline = time.monotonic() + GRACE
    while pids := [int(pid) for pid in _output(["ip", "netns", "pids", namespace]).split()]:
        for pid in pids:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGTERM if time.monotonic() < deadline else signal.SIGKILL)
        time.sleep(0.1)


def _output(words: Sequence[str]) -> str:
    return subprocess.run(words, capture_output=True, text=True, check=False).stdout


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True, text=True)


def release(folder: Path, name: str, program: str) -> Path:
    """A specification in which ``program`` talks to the listener of the example. The paths are whole, for any `up`."""
    path, file = folder / f"{name}.py", folder / f"{name}.stride"
    path.write_text(program)
    text = TALKER.read_text(encoding="utf-8").replace("new_talker.py", str(path))
    text = text.replace("listener.py", str(TALKER.parent / "listener.py"))
    text = text.replace("python3 talker.py", f"python3 {TALKER.parent / 'talker.py'}")
    file.write_text(text.replace("talker   : Talker ", "talker   : NewTalker "))
    return file


def new_program() -> str:
    return (TALKER.parent / "new_talker.py").read_text(encoding="utf-8")


def tiring_program() -> str:
    """It passes its probation, and after two seconds writes one message of ten."""
    return new_program().replace("    out.write(", "    if said < 20 or not said % 10:\n        out.write(")


@contextlib.contextmanager
def fleet(folder: Path, domains: Sequence[int]) -> Iterator[Fleet]:
    """As many robots as ``domains``, without their systems, while the context is open."""
    found = Fleet(folder, domains)
    try:
        found.make()
        yield found
    finally:
        found.remove()
