"""The commands of OpenSSH that reach a host, and what its messages mean for whoever reads them.

The user's own configuration, keys, agent and known hosts are used. Nothing is asked (``BatchMode``): what would need an
answer is said instead, with what to do. ``MIDSTRIDE_SSH_CONFIG`` names another file of configuration.
"""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from midstride.model.hosts import HostSpec
from midstride.model.printable import printable

CONFIG_VARIABLE: Final = "MIDSTRIDE_SSH_CONFIG"
# How long a connection may take to be made (s), and how often a silent one is asked, and how often in vain, until it
# is given up: after 4 to 6 s.
CONNECT_SECONDS: Final = 10
_ALIVE: Final = (2, 2)
_OPTIONS: Final[Mapping[str, str]] = {
    "BatchMode": "yes",
    "ControlMaster": "yes",
    "ControlPersist": "no",
    "ConnectTimeout": str(CONNECT_SECONDS),
    "ServerAliveInterval": str(_ALIVE[0]),
    "ServerAliveCountMax": str(_ALIVE[1]),
    "StreamLocalBindUnlink": "yes",
    "StreamLocalBindMask": "0177",
    "ClearAllForwardings": "yes",
    "ForwardAgent": "no",
    "ForwardX11": "no",
    "PermitLocalCommand": "no",
    "RemoteCommand": "none",
    "RequestTTY": "no",
    "LogLevel": "INFO",
}
# The statuses with which the commands below end where something is not there. OpenSSH's own is 255.
_NO_SETUP, _NO_COMMAND, _NOT_FOUND, _WRONG_USE, _SSH = 80, 81, 127, 2, 255
_WITH_SETUP: Final = (
    'test -r "$1" || exit 80; . "$1" </dev/null >&2; command -v midstride >/dev/null || exit 81; exec midstride host'
)


def connect_command(host: HostSpec, control: Path, environment: Mapping[str, str] = os.environ) -> list[str]:
    """The command that logs in on ``host`` and starts `midstride host` there, which has its order on standard input."""
    options = [word for name, value in _OPTIONS.items() for word in ("-o", f"{name}={value}")]
    return [*_ssh(environment), "-T", *options, "-o", f"ControlPath={control}", "--", host.ssh, remote_command(host)]


def remote_command(host: HostSpec) -> str:
    """The command for the login shell of the host: `setup` is sourced by bash, as ROS's are."""
    if host.setup is None:
        return "exec midstride host"
    return f"exec bash -c {shlex.quote(_WITH_SETUP)} midstride-host {shlex.quote(host.setup)}"


def forward_command(host: HostSpec, control: Path, local: Path, remote: str) -> list[str]:
    """The command that has a connection forward the socket ``local`` to ``remote``, a path on the host.

    It talks to the connection alone, so it reads no configuration: what that forwards besides, such as a port, would be
    opened as well.
    """
    words = ["-F", "/dev/null", "-o", f"ControlPath={control}", "-O", "forward", "-o", "StreamLocalBindMask=0177"]
    return ["ssh", *words, "-o", "StreamLocalBindUnlink=yes", "-L", f"{local}:{remote}", "--", host.ssh]


def _ssh(environment: Mapping[str, str]) -> list[str]:
    config = environment.get(CONFIG_VARIABLE)
    return ["ssh", *(["-F", config] if config else [])]


# What OpenSSH says -> what is wrong, and what to do. ``{to}``: the destination; ``{words}``: it, after the option for
# another configuration than the user's, which is ``{config}``. The first that is found counts.
_MESSAGES: Final = (
    (
        r"REMOTE HOST IDENTIFICATION HAS CHANGED|host key for .* has changed",
        "its host key is not the one that is known: if the computer was set up anew, remove the old key (`ssh-keygen "
        "-R NAME`, as `ssh {words}` says) and accept the new one with `ssh {words}`; else somebody may answer in its "
        "place",
    ),
    (
        r"Host key verification failed|No .* host key is known",
        "its host key is not known here: run `ssh {words}` once, compare the key with the one of the host, and accept "
        "it",
    ),
    (
        r"Could not resolve hostname",
        "its name is not known: correct the destination `{to}`, or describe it in {config} (`Host`, `HostName`)",
    ),
    (
        r"Permission denied|Too many authentication failures",
        "`ssh {words}` cannot log in without a question (permission denied): install your key there (`ssh-copy-id "
        "{words}`), and load it (`ssh-add`) where it has a passphrase",
    ),
    (
        r"Connection refused",
        "it refuses connections of SSH: start the SSH server there (`systemctl start ssh`), or state its port in "
        "{config}",
    ),
    (
        r"No route to host|Network is unreachable|Connection timed out|timed out|not responding",
        "it does not answer over the network: is it switched on, and does `ping` reach it?",
    ),
    (
        r"Bad owner or permissions on|Bad configuration option|terminating, \d+ bad configuration",
        "ssh does not take its configuration here: {last}",
    ),
    (
        r"kex_exchange_identification|Connection closed by|Connection reset by|Broken pipe",
        "the SSH connection was closed: {last}",
    ),
)


def meaning(host: HostSpec, status: int, errors: str, environment: Mapping[str, str] = os.environ) -> str:
    """One sentence on why the command of :func:`connect_command` ended, with what to do.

    ``errors``: the end of what it has written to standard error. ``status``: negative for a signal.
    """
    last, options = last_line(errors), _ssh(environment)[1:]
    words = shlex.join([*options, host.ssh])
    if status in (_NO_COMMAND, _NOT_FOUND):
        where = (
            f"with {host.setup} sourced" if host.setup else "for a login without a terminal, and no `setup` is stated"
        )
        return (
            f"there is no command `midstride` on the PATH there, {where}: install Midstride there (`pip install "
            'midstride`), or state a file that puts it on the PATH (`setup "/…/setup.bash"`)'
        )
    if status == _NO_SETUP:
        return f"its `setup` {host.setup} is not there or cannot be read: correct it, or create the file there"
    if status == _WRONG_USE and "host" in errors:
        return "its Midstride has no command `host`: install the same version there as here"
    for pattern, text in _MESSAGES if status == _SSH else ():  # else `setup` or another program there may say so
        if re.search(pattern, errors):
            config = options[-1] if options else "~/.ssh/config"
            return text.format(to=host.ssh, words=words, config=config, last=last)
    how = f"was ended by signal {-status}" if status < 0 else f"ended with status {status}"
    return f"`ssh {words}` {how}" + (f": {last}" if last else ", and said nothing")


def refuses_forwarding(errors: str) -> bool:
    """Return whether the SSH server has said that it does not forward."""
    return re.search(r"administratively prohibited|forwarding request failed|open failed", errors) is not None


def forwarding_refused() -> str:
    """The reason why the socket of a host process that listens cannot be reached through SSH, with what to do."""
    return (
        "its SSH server does not forward Unix sockets: set `AllowStreamLocalForwarding yes` in /etc/ssh/sshd_config "
        "there, where `DisableForwarding` must not be set, and reload it (`systemctl reload ssh`)"
    )


def last_line(errors: str) -> str:
    """The last line of what ssh has written, as it can be shown."""
    lines = [line.strip() for line in errors.splitlines() if line.strip()]
    return printable(lines[-1][:300]) if lines else ""
