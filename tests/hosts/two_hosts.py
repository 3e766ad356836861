"""Two hosts on one machine: network namespaces with a link between them, and an SSH server of the second one.

Both have the machine's files, clock and processes. Nothing of the machine's own SSH is used: the server has a key and
a configuration for one test, and so has the client (``MIDSTRIDE_SSH_CONFIG``).
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from tests.hosts import slow_link
from tests.hosts.slow_link import Passed, Slow

NETWORK, CABLE = "10.211.77", "cable"
SSHD = "/usr/sbin/sshd"


def missing() -> str | None:
    """Why two hosts cannot be had here; None if they can."""
    if os.getuid() != 0:
        return "network namespaces need root"
    for command in ("ip", "tc", "nsenter", "ssh", "ssh-keygen", SSHD):
        if shutil.which(command) is None:
            return f"there is no {command}"
    name = f"midstride-{os.getpid()}-try"
    made = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True)
    subprocess.run(["ip", "netns", "del", name], capture_output=True)
    return made.stderr.strip() or "ip netns add failed" if made.returncode else None


@dataclass
class TwoHosts:
    """``folder``: of all that belongs to them. The manager's host is the namespace ``near``, the host `arm` ``far``.

    ``slow``: what the link between them does to frames, if it is not a cable.
    """

    folder: Path
    slow: Slow | None = None
    near: str = field(default_factory=lambda: f"midstride-{os.getpid()}-near")
    far: str = field(default_factory=lambda: f"midstride-{os.getpid()}-far")
    _server: subprocess.Popen[bytes] | None = None
    _slow_link: subprocess.Popen[str] | None = None

    @property
    def config(self) -> Path:
        return self.folder / "ssh_config"

    @property
    def setup(self) -> Path:
        return self.folder / "setup.bash"

    def declaration(self, folder: Path) -> str:
        """The host in a specification."""
        return f'host arm {{ ssh "arm"   setup "{self.setup}"   folder "{folder}" }}\n'

    def inside(self, *words: object) -> list[str]:
        """The command, on the manager's host."""
        return ["nsenter", f"--net=/run/netns/{self.near}", *map(str, words)]

    def link(self, state: str) -> None:
        """Have the cable ``up`` or ``down``."""
        _ip("-n", self.near, "link", "set", CABLE, state)

    def lose(self, everything: bool) -> None:
        """Have what is sent over the cable be lost, both ways, while the interfaces stay up: a queue without room."""
        change = (
            ["replace", "dev", CABLE, "root", "pfifo", "limit", "0"] if everything else ["del", "dev", CABLE, "root"]
        )
        for name in (self.near, self.far):
            subprocess.run(["ip", "netns", "exec", name, "tc", "qdisc", *change], check=True, capture_output=True)

    def make(self) -> None:
        for name in (self.near, self.far):
            _ip("netns", "add", name)
            for kind in ("all", "default"):  # no address of IPv6: the link is usable as soon as it is up
                inside = ["ip", "netns", "exec", name, "sysctl", "-qw", f"net.ipv6.conf.{kind}.disable_ipv6=1"]
                subprocess.run(inside, check=False, capture_output=True)
        if self.slow is not None:
            self._slow_link = slow_link.start([self.near, self.far], CABLE, self.slow)
        else:
            _ip("-n", self.near, "link", "add", CABLE, "type", "veth", "peer", "name", CABLE, "netns", self.far)
        for number, name in enumerate((self.near, self.far), start=1):
            _ip("-n", name, "address", "add", f"{NETWORK}.{number}/24", "dev", CABLE)
            for device in ("lo", CABLE):
                _ip("-n", name, "link", "set", device, "up")
        _until(self._cable_is_up, "the cable is up")
        self.setup.write_text(f'export PATH="{Path(sys.executable).parent}:$PATH"\n')
        self.serve()

    def serve(self, *options: str) -> None:
        """Start the SSH server of the far host, with keys of its own; ``options``: lines of its configuration."""
        for key in ("host_key", "user_key"):
            if not (self.folder / key).exists():
                words = ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(self.folder / key)]
                subprocess.run(words, check=True)
        public = " ".join((self.folder / "host_key.pub").read_text().split()[:2])
        (self.folder / "known_hosts").write_text(f"{NETWORK}.2 {public}\n")
        Path("/run/sshd").mkdir(exist_ok=True)
        (self.folder / "sshd_config").write_text(
            "\n".join(
                [
                    *options,
                    f"ListenAddress {NETWORK}.2",
                    f"HostKey {self.folder}/host_key",
                    f"AuthorizedKeysFile {self.folder}/user_key.pub",
                    f"PidFile {self.folder}/sshd.pid",
                    "PasswordAuthentication no",
                    "KbdInteractiveAuthentication no",
                    "PermitRootLogin yes",
                    "StrictModes no",
                    "UsePAM no",
                ]
            )
            + "\n"
        )
        self.config.write_text(
            f"Host arm\n  HostName {NETWORK}.2\n  User root\n  IdentityFile {self.folder}/user_key\n"
            f"  IdentitiesOnly yes\n  UserKnownHostsFile {self.folder}/known_hosts\n  StrictHostKeyChecking yes\n"
        )
        words = [SSHD, "-D", "-E", str(self.folder / "sshd.log"), "-f", str(self.folder / "sshd_config")]
        self._server = subprocess.Popen(["nsenter", f"--net=/run/netns/{self.far}", *words])
        _until(self._serves, "the SSH server listens")

    def _cable_is_up(self) -> bool:
        return all("LOWER_UP" in _ip("-n", name, "link", "show", CABLE) for name in (self.near, self.far))

    def _serves(self) -> bool:
        listening = ["nsenter", f"--net=/run/netns/{self.far}", "cat", "/proc/net/tcp"]
        return ":0016 00000000:0000 0A" in subprocess.run(listening, capture_output=True, text=True).stdout

    def listening(self, side: str) -> list[str]:
        """The local addresses of the TCP ports that listen on the host ``near`` or ``far``."""
        name = self.near if side == "near" else self.far
        look = ["nsenter", f"--net=/run/netns/{name}", "cat", "/proc/net/tcp", "/proc/net/tcp6"]
        lines = subprocess.run(look, capture_output=True, text=True).stdout.splitlines()
        return sorted(words[1] for line in lines if len(words := line.split()) > 3 and words[3] == "0A")

    def stop_serving(self) -> None:
        if self._server is not None:
            self._server.terminate()
            self._server.wait()
            self._server = None

    def stop_slow_link(self) -> Passed:
        """Remove the link that is not a cable; what it has done."""
        assert self._slow_link is not None
        process, self._slow_link = self._slow_link, None
        return slow_link.stop(process)

    def remove(self) -> None:
        self.stop_serving()
        if self._slow_link is not None:
            self.stop_slow_link()
        for name in (self.near, self.far):
            subprocess.run(["ip", "netns", "del", name], capture_output=True)


def _ip(*words: str) -> str:
    return subprocess.run(["ip", *words], check=True, capture_output=True, text=True).stdout


def _until(condition: Callable[[], bool], what: str, seconds: float = 10.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.02)


def traffic(namespace: str) -> int:
    """The bytes that went over the cable of a namespace so far, both ways, with the headers of Ethernet."""
    (link,) = json.loads(_ip("-n", namespace, "-s", "-j", "link", "show", CABLE))
    return int(link["stats64"]["rx"]["bytes"]) + int(link["stats64"]["tx"]["bytes"])


@contextlib.contextmanager
def two_hosts(folder: Path, slow: Slow | None = None) -> Iterator[TwoHosts]:
    """Two hosts while the context is open, with a cable or a ``slow`` link between them, for tests marked hosts."""
    if slow is not None and not os.access("/dev/net/tun", os.R_OK | os.W_OK):
        pytest.skip("there is no /dev/net/tun for a slow link")
    hosts = TwoHosts(folder, slow)
    try:
        hosts.make()
        yield hosts
    finally:
        hosts.remove()
