"""The view that other processes have of this one in ``/proc``: its command line, and a variable of its environment.

A spare (:mod:`.spare`) becomes a component after it has started. `ps` and `pgrep` shall show that component's command,
and the next manager identifies a process by its environment. Both are memory of the process that the kernel shows as
it is, so writing there changes them; not their lengths, so room has to be reserved at the start.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Final

# An argument that reserves room for a command line, and the value of a variable that reserves room for another value.
ARGUMENT_ROOM: Final = " " * 2000
VALUE_ROOM: Final = " " * 250


def show(arguments: Sequence[str], variable: str, value: str) -> None:
    """Show ``arguments`` as the command line, and ``value`` as the value of ``variable``.

    The process was started with ARGUMENT_ROOM as its last argument, and VALUE_ROOM as that value. A longer command line
    is cut. Raises OSError where the kernel does not say where they are, ValueError where no room was reserved.
    """
    # Fields 48 to 51 of proc(5); the second one, the name of the command in parentheses, may contain spaces.
    fields = Path("/proc/self/stat").read_text().rpartition(")")[2].split()
    first_argument, last_argument, first_variable, last_variable = map(int, fields[45:49])
    # Where the last byte is not zero, the kernel takes the first string for the whole command line.
    room = last_argument - first_argument - 2
    title = os.fsencode(" ".join(arguments))[:room].ljust(room, b"\0") + b"\0."
    reserved = f"\0{variable}={VALUE_ROOM}\0".encode()
    environment = b"\0" + ctypes.string_at(first_variable, last_variable - first_variable)
    shown = os.fsencode(value)
    if (found := environment.find(reserved)) < 0 or len(shown) > len(VALUE_ROOM):
        raise ValueError(f"{variable} has no room for {value!r}")
    ctypes.memmove(first_argument, title, len(title))
    ctypes.memmove(first_variable + found + len(variable) + 1, shown.ljust(len(VALUE_ROOM), b"\0"), len(VALUE_ROOM))
