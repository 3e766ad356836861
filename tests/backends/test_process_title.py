"""The command line and the environment that `/proc` shows of a process that became another program."""

from __future__ import annotations

import os
import subprocess
import sys

import psutil
import pytest

from midstride.backends.process_title import ARGUMENT_ROOM, VALUE_ROOM
from midstride.runtime.process.reaper import environment_value

CODE = """
import os, sys
from midstride.backends import process_title
try:
    process_title.show(sys.argv[1].split(","), "NAME_OF_IT", sys.argv[2])
except ValueError as error:
    print(error)
print("shown", os.environ["NAME_OF_IT"].strip(), os.environ["AFTER"], flush=True)
sys.stdin.read()
"""


def shown(command: str, value: str, room: str = VALUE_ROOM) -> tuple[str, str | None, str, str]:
    """What it prints, and its variable, its environment's next one, and its command line as others see them."""
    environment = {**os.environ, "NAME_OF_IT": room, "AFTER": "unchanged"}
    arguments = [sys.executable, "-c", CODE, command, value, ARGUMENT_ROOM]
    with subprocess.Popen(
        arguments, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdin is not None and process.stdout is not None
        try:
            said = process.stdout.readline()
            after = environment_value(process.pid, "AFTER")
            return (
                said,
                environment_value(process.pid, "NAME_OF_IT"),
                str(after),
                " ".join(psutil.Process(process.pid).cmdline()),
            )
        finally:
            process.stdin.close()


def test_others_see_the_new_command_and_the_new_value() -> None:
    said, value, after, command = shown("python3,talker.py,a b", "talker_2")
    assert (value, after, command) == ("talker_2", "unchanged", "python3 talker.py a b")
    assert said == "shown  unchanged\n"  # os.environ is for the caller to change


def test_a_command_line_that_is_too_long_is_cut() -> None:
    _, value, after, command = shown(",".join(["python3", "x" * 9000]), "talker")
    assert (value, after) == ("talker", "unchanged")
    assert command.startswith("python3 xxxx") and len(command) > 2000


@pytest.mark.parametrize(("value", "room"), [("x" * 251, VALUE_ROOM), ("x", "")])
def test_a_value_without_room_is_refused_and_changes_nothing(value: str, room: str) -> None:
    said, seen, after, command = shown("python3,talker.py", value, room)
    assert said.startswith("NAME_OF_IT has no room for 'x")
    assert (seen, after) == (room, "unchanged")
    assert sys.executable in command
