"""prebuilt_gate.py FOLDER MACHINE COMPILER…: compiles the library of the gate for a machine into the sources in FOLDER.

FOLDER has the package, as an unpacked sdist does. Fails if the library does not run with C libraries as old as OLDEST.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from midstride.errors import StartFailed
from midstride.foreign import build
from midstride.foreign.elf import MACHINES, read_elf

# The C library of Ubuntu 22.04, which ROS 2 Humble is for: 2.35.
OLDEST = 35
PROCESSORS = {"x86_64": "x86-64", "aarch64": "arm64"}


def main(folder: str, machine: str, *compiler: str) -> int:
    sources = Path(folder) / "src" / "midstride" / "foreign"
    same = [(sources / "gate" / path.name).read_bytes() == path.read_bytes() for path in build.SOURCES]
    if not all(same):
        print(f"the sources in {sources} are not those of this repository", file=sys.stderr)
        return 1
    path = sources / build.PREBUILT.name / build.library_name(machine)
    try:
        build.compile_library(compiler, path)
    except StartFailed as error:
        print(error, file=sys.stderr)
        return 1
    found = read_elf(path)
    if found is None or MACHINES.get(found.machine) != PROCESSORS[machine]:
        print(f"{path} is not for {machine}", file=sys.stderr)
        return 1
    needed = max(int(minor) for minor in re.findall(rb"GLIBC_2\.(\d+)", path.read_bytes()))
    if needed > OLDEST:
        print(f"{path} needs glibc 2.{needed}, and 2.{OLDEST} is to do", file=sys.stderr)
        return 1
    print(f"{path.name} for glibc 2.{needed} or later")
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
