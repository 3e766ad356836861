"""``systemd``: write the unit with which systemd keeps a system up."""

from __future__ import annotations

import os
import pwd
import resource
import shlex
import sys
from pathlib import Path
from typing import Final

import click

from midstride.cli.input_files import load, write
from midstride.cli.manager_options import ManagerOptions, manager_options
from midstride.cli.output import json_option, print_json, wants_json
from midstride.cli.specification_argument import absolute, specification_argument
from midstride.cli.systemd_unit import Unit, user_runtime
from midstride.lang.source_files import INCLUDE_PATH

# Directive -> (limit, what systemd gives on its own): real-time priorities, niceness, locked memory (bytes).
_LIMITS: Final = {
    "LimitRTPRIO": (resource.RLIMIT_RTPRIO, 0),
    "LimitNICE": (resource.RLIMIT_NICE, 0),
    "LimitMEMLOCK": (resource.RLIMIT_MEMLOCK, 8 << 20),
}


@click.command("systemd")
@specification_argument()
@manager_options
@click.option("--user", is_flag=True, help="A unit of your own systemd, which needs no root.")
@click.option(
    "--setup",
    multiple=True,
    metavar="SCRIPT",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    help="Have Bash read SCRIPT at each start, such as install/setup.bash, instead of keeping the paths of this shell.",
)
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, dir_okay=False), metavar="PATH", help="Write the unit to PATH."
)
@json_option
def systemd_command(
    file: Path, options: ManagerOptions, user: bool, setup: tuple[Path, ...], output: Path | None
) -> int:
    """Print a systemd unit that brings the system of FILE up at boot, and keeps its manager running.

    The unit has the options of `up` given here, the environment of ROS and the Python of this shell, and runs as the
    user of this shell. Standard error says how to install it; see docs/how-to/systemd.md.
    """
    specification = load(file)
    me = pwd.getpwuid(os.getuid())
    unit = Unit(
        specification.name,
        absolute(file),
        [sys.executable, "-m", "midstride"],
        options.arguments(file),
        _environment(),
        [script.resolve() for script in setup],
        None if user else me.pw_name,
        me.pw_uid,
        os.environ.get("XDG_RUNTIME_DIR") or user_runtime(me.pw_uid),
        _limits(),
    )
    text = unit.text()
    if output is not None:
        write(output, text)
    if wants_json():
        print_json({"unit": unit.name, "text": text})
        return 0
    if output is None:
        click.echo(text, nl=False)
    for line in _what_to_do(unit, output, me.pw_name):
        click.echo(line, err=True)
    return 0


def _environment() -> dict[str, str]:
    """The environment of this shell, as it is to be read from another folder."""
    environment = dict(os.environ)
    if folders := [each for each in environment.get(INCLUDE_PATH, "").split(os.pathsep) if each]:
        environment[INCLUDE_PATH] = os.pathsep.join(map(os.path.abspath, folders))
    return environment


def _limits() -> dict[str, str]:
    """The limits that this user has been given; a service has none of those of a login."""
    found = {}
    for directive, (limit, usual) in _LIMITS.items():
        hard = resource.getrlimit(limit)[1]
        if hard == resource.RLIM_INFINITY:
            found[directive] = "infinity"
        elif hard > usual:
            found[directive] = str(hard)
    return found


def _what_to_do(unit: Unit, output: Path | None, user: str) -> list[str]:
    """The commands that install and start the unit."""
    name = Path(unit.name).stem
    given = shlex.quote(str(output or unit.name))
    first = [] if output is not None else [f"midstride systemd … -o {given}"]
    if unit.user is None:
        folder = "~/.config/systemd/user"
        commands = [
            *first,
            f"install -D -m 644 {given} {folder}/{unit.name}",
            "systemctl --user daemon-reload",
            f"systemctl --user enable --now {name}",
            "loginctl enable-linger  # at boot, before anybody logs in",
        ]
    else:
        commands = [
            *first,
            f"sudo install -m 644 {given} /etc/systemd/system/{unit.name}",
            "sudo systemctl daemon-reload",
            f"sudo systemctl enable --now {name}",
        ]
        if unit.uid != 0:
            commands.append(f"sudo loginctl enable-linger {user}  # else shared memory goes with the last log-out")
    return ["To install it:", *(f"  {command}" for command in commands)]
