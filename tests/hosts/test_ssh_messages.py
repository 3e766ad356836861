"""Each message of OpenSSH becomes one sentence with what to do; the texts are those of OpenSSH 9.2."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
from pathlib import Path

import pytest

from midstride.errors import ProtocolError
from midstride.model.hosts import HostSpec
from midstride.runtime.hosts import ssh
from midstride.runtime.hosts.host_frames import HOST_PROTOCOL
from midstride.runtime.hosts.host_order import HostOrder, HostReport
from midstride.runtime.hosts.ssh_connection import HostFault, SshConnection

ARM = HostSpec("arm", "robot@arm")
WITH_SETUP = HostSpec("arm", "robot@arm", setup="/opt/ros/jazzy/setup.bash")
CHANGED = """@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@
@    WARNING: REMOTE HOST IDENTIFICATION HAS CHANGED!     @
@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@
IT IS POSSIBLE THAT SOMEONE IS DOING SOMETHING NASTY!
Host key for arm has changed and you have requested strict checking.
Host key verification failed.
"""
MESSAGES = [
    (255, "ssh: Could not resolve hostname arm: Name or service not known\n", "its name is not known"),
    (255, "ssh: connect to host 10.0.0.2 port 22: Connection refused\n", "refuses connections of SSH"),
    (255, "ssh: connect to host 10.0.0.2 port 22: Connection timed out\n", "it does not answer over the network"),
    (255, "ssh: connect to host 10.0.0.2 port 22: No route to host\n", "it does not answer over the network"),
    (255, "ssh: connect to host 10.0.0.2 port 22: Network is unreachable\n", "it does not answer over the network"),
    (255, "Timeout, server 10.0.0.2 not responding.\n", "it does not answer over the network"),
    (255, CHANGED, "not the one that is known"),
    (
        255,
        "No ED25519 host key is known for 10.0.0.2 and you have requested strict checking.\n"
        "Host key verification failed.\n",
        "its host key is not known here",
    ),
    (255, "robot@arm: Permission denied (publickey,password).\n", "`ssh-copy-id robot@arm`"),
    (255, "/home/robot/.ssh/config: line 2: Bad configuration option: bananas\n", "line 2: Bad configuration option"),
    (127, "bash: line 1: exec: midstride: not found\n", "no command `midstride` on the PATH there"),
    (81, "", "no command `midstride` on the PATH there"),
    (255, "", "ended with status 255, and said nothing"),
    (2, "midstride: there is no command `host`; did you mean `log`?\n", "its Midstride has no command `host`"),
    (1, "something\x1b[2J else\n", "ended with status 1: something\\x1b[2J else"),
    (1, "setup.bash: line 3: /opt/x: Permission denied\nno\n", "`ssh robot@arm` ended with status 1: no"),
    (-9, "", "was ended by signal 9, and said nothing"),
]


@pytest.mark.parametrize(("status", "errors", "words"), MESSAGES)
def test_what_ssh_says_is_one_sentence_with_what_to_do(status: int, errors: str, words: str) -> None:
    found = ssh.meaning(ARM, status, errors)
    assert words in found and "\n" not in found


def test_the_configuration_in_force_is_the_one_that_is_named() -> None:
    """Else the advice would be followed for another destination, or none."""
    other = {ssh.CONFIG_VARIABLE: "/robots/my config"}
    refused, closed = "robot@arm: Permission denied (publickey).\n", "ssh: connect to host arm: Connection refused\n"
    assert "(`ssh-copy-id -F '/robots/my config' robot@arm`)" in ssh.meaning(ARM, 255, refused, other)
    assert "state its port in /robots/my config" in ssh.meaning(ARM, 255, closed, other)
    assert "state its port in ~/.ssh/config" in ssh.meaning(ARM, 255, closed, {})


def test_a_setup_that_is_not_there_is_named() -> None:
    assert "/opt/ros/jazzy/setup.bash is not there" in ssh.meaning(WITH_SETUP, 80, "")
    assert "with /opt/ros/jazzy/setup.bash sourced" in ssh.meaning(WITH_SETUP, 81, "")


def test_nothing_of_the_declaration_is_taken_for_an_option_or_a_command(tmp_path: Path) -> None:
    """A destination that begins with a dash, and a setup with quotes and a command in it."""
    host = HostSpec("arm", "-oProxyCommand=touch x", setup="/opt/a b'; touch /tmp/x; '/setup.bash")
    words = ssh.connect_command(host, tmp_path / "c", {})
    assert words[words.index("--") + 1] == host.ssh and len(words) == words.index("--") + 3
    probe = tmp_path / "setup file'; false; '.bash"
    probe.write_text("echo sourced")
    text = ssh.remote_command(HostSpec("arm", "arm", setup=str(probe))).replace("exec midstride host", "exec true")
    text = text.replace("command -v midstride", "command -v true")
    assert os.system(f"{text} 2>/dev/null") == 0


def test_nothing_secret_and_nothing_of_the_order_is_in_the_arguments(tmp_path: Path) -> None:
    assert ssh.remote_command(ARM) == "exec midstride host"
    assert not any("folder" in word or "token" in word for word in ssh.connect_command(ARM, tmp_path / "c", {}))


def test_a_forwarding_adds_none_of_the_users_configuration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Such as a `LocalForward`, which opens a port here."""
    (tmp_path / "config").write_text("Host arm\n  LocalForward 127.0.0.1:18999 127.0.0.1:1\n")
    monkeypatch.setenv(ssh.CONFIG_VARIABLE, str(tmp_path / "config"))
    words = ssh.forward_command(HostSpec("arm", "arm"), tmp_path / "c", tmp_path / "arm.sock", "/opt/host.sock")
    shown = subprocess.run([words[0], "-G", *words[1:]], capture_output=True, text=True, check=True).stdout
    found = [line for line in shown.splitlines() if line.startswith("localforward")]
    assert found == [f"localforward {tmp_path / 'arm.sock'} /opt/host.sock"]


def test_another_configuration_of_ssh_can_be_named(tmp_path: Path) -> None:
    assert ssh.connect_command(ARM, tmp_path / "c", {ssh.CONFIG_VARIABLE: "/x"})[:3] == ["ssh", "-F", "/x"]


@pytest.mark.parametrize(
    "path",
    [
        "/tmp/a:b/host.sock",
        "/tmp/a%b/host.sock",
        "relative/host.sock",
        "/tmp/x/other.sock",
        "/" + 120 * "a" + "/host.sock",
    ],
)
def test_a_path_that_a_host_answers_with_is_checked_before_it_is_forwarded(path: str) -> None:
    line = json.dumps({"midstride_host": HOST_PROTOCOL, "socket": path, "components": "/tmp/components"}).encode()
    with pytest.raises(ProtocolError, match="cannot forward"):
        HostReport.read(line)


@pytest.mark.parametrize("line", [b"{}", b'{"midstride_host": "x"}', b"[1", b'{"midstride_host": 1, "user": 7}'])
def test_an_answer_that_is_none_is_refused(line: bytes) -> None:
    with pytest.raises(ProtocolError, match="something else"):
        HostReport.read(line)


def test_an_order_names_a_system_and_a_host() -> None:
    good = {
        "protocol": HOST_PROTOCOL,
        "system": "home",
        "host": "arm",
        "variables": {"LD_PRELOAD": "x", "ROS_DOMAIN_ID": "3"},
    }
    assert HostOrder.read(json.dumps(good).encode()).variables == {"ROS_DOMAIN_ID": "3"}
    for wrong in ({"system": "../x"}, {"host": "a/b"}, {"host": ""}):
        with pytest.raises(ProtocolError, match="cannot name"):
            HostOrder.read(json.dumps(good | wrong).encode())


# -- the connection, with a program that stands in for ssh ---------------------------------------------------------


@pytest.fixture
def stand_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the program, which is first on the PATH as ``ssh``."""
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "ssh").symlink_to(Path(__file__).parent / "ssh_stand_in.py")
    (tmp_path / "home").mkdir()
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}:{os.environ['PATH']}")
    monkeypatch.setenv("STAND_IN_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("STAND_IN_SAYS", str(tmp_path / "says"))
    monkeypatch.setenv("STAND_IN_CALLS", str(tmp_path / "calls"))
    return tmp_path


def fault(folder: Path, host: HostSpec = ARM, **order: object) -> str:
    """Why a connection to ``host`` cannot be made."""

    async def attempt() -> str:
        connection = SshConnection(host, folder)
        asked = HostOrder(**{"protocol": HOST_PROTOCOL, "system": "home", "host": "arm", **order})  # type: ignore[arg-type]
        try:
            with pytest.raises(HostFault) as caught:
                await connection.open(asked)
            return str(caught.value)
        finally:
            await connection.close()

    return asyncio.run(attempt())


def test_a_login_that_is_refused_says_why(stand_in: Path) -> None:
    (stand_in / "says").write_text(
        json.dumps({"step": "login", "status": 255, "text": "robot@arm: Permission denied (publickey).\n"})
    )
    assert "ssh-copy-id robot@arm" in fault(stand_in)


def test_no_midstride_on_the_path_of_a_login(stand_in: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", f"{stand_in / 'bin'}:/usr/bin:/bin")
    assert "no command `midstride` on the PATH there" in fault(stand_in)
    setup = stand_in / "setup.bash"
    assert "is not there or cannot be read" in fault(stand_in, HostSpec("arm", "arm", setup=str(setup)))
    setup.write_text("echo noise\n")
    assert f"with {setup} sourced" in fault(stand_in, HostSpec("arm", "arm", setup=str(setup)))


def answering(folder: Path, script: str) -> HostSpec:
    """A host where `midstride` is a shell script."""
    (folder / "there").mkdir()
    program = folder / "there" / "midstride"
    program.write_text(f"#!/bin/sh\nread -r order\n{script}\n")
    program.chmod(0o755)
    (folder / "setup.bash").write_text(f"PATH={folder / 'there'}:$PATH\n")
    return HostSpec("arm", "robot@arm", setup=str(folder / "setup.bash"))


def report(**fields: object) -> str:
    return json.dumps({"midstride_host": HOST_PROTOCOL, **fields})


def test_what_the_host_says_is_passed_on(stand_in: Path) -> None:
    words = "the folder /opt/robot there cannot be written by robot (Permission denied)"
    host = answering(stand_in, f"echo welcome to arm\necho '{report(problem=words)}'")
    assert fault(stand_in, host) == words


def test_a_server_that_does_not_forward_says_so(stand_in: Path) -> None:
    host = answering(stand_in, f"echo '{report(socket='/tmp/x/host.sock', components='/tmp/x/components')}'; sleep 5")
    text = "mux_client_forward: forwarding request failed: Port forwarding failed\n"
    (stand_in / "says").write_text(json.dumps({"step": "forward", "status": 255, "text": text}))
    assert "AllowStreamLocalForwarding yes" in fault(stand_in, host)


def test_a_login_that_prints_without_end_is_given_up(stand_in: Path) -> None:
    assert "prints too much" in fault(stand_in, answering(stand_in, "yes hello"))


def test_a_connection_leaves_no_process_and_no_file(stand_in: Path) -> None:
    host = answering(stand_in, f"echo '{report(problem='no')}'; exec cat >/dev/null")
    fault(stand_in, host)
    calls = [json.loads(line) for line in (stand_in / "calls").read_text().splitlines()]
    assert len(calls) == 1 and "BatchMode=yes" in calls[0]
    assert not [*stand_in.glob("arm.*sock"), *stand_in.glob("arm.*ctl")]


def test_what_managers_before_have_left_is_removed_and_what_one_beside_uses_is_not(stand_in: Path) -> None:
    """The `ssh` of a manager that is killed removes its control socket by its path, when the next one has begun."""
    host = answering(stand_in, f"echo '{report(socket='/tmp/x/host.sock', components='/tmp/x/components')}'; sleep 5")
    left, used = stand_in / "arm.999999999.ctl", stand_in / f"arm.{os.getppid()}.ctl"
    for path in (left, used):
        path.touch()

    async def replaced() -> None:
        connection = SshConnection(host, stand_in)
        assert connection.control not in (left, used)
        await connection.open(HostOrder(protocol=HOST_PROTOCOL, system="home", host="arm"))
        assert connection.local.is_symlink() and not left.exists() and used.exists()
        connection.local.unlink()
        connection.local.touch()
        await connection.close()
        assert connection.local.exists(), "another manager has taken over"

    asyncio.run(replaced())
