"""wheel_contents.py WHEEL MACHINE…: fails unless the wheel holds the package and the examples, and nothing else.

For each MACHINE it has the library of the gate, made from the sources as they are here: its name has their hash.
"""

from __future__ import annotations

import sys
import zipfile
from pathlib import Path

from midstride.foreign import build

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = {"src/midstride": "midstride", "examples": "midstride/examples"}


def expected() -> set[str]:
    """The files of the repository, by their names in the wheel."""
    return {
        f"{installed}/{file.relative_to(ROOT / folder).as_posix()}"
        for folder, installed in FOLDERS.items()
        for file in (ROOT / folder).rglob("*")
        if file.is_file() and "__pycache__" not in file.parts
    }


def prebuilt(machine: str) -> str:
    """The name of the library of the gate for a machine, in the wheel."""
    return f"midstride/{build.prebuilt_path(machine).relative_to(ROOT / 'src' / 'midstride').as_posix()}"


def main(wheel: str, *machines: str) -> int:
    with zipfile.ZipFile(wheel) as archive:
        found = {name for name in archive.namelist() if ".dist-info/" not in name}
    wanted = expected() | {prebuilt(machine) for machine in machines}
    for name in sorted(wanted - found):
        print(f"wheel: {name} is missing in {Path(wheel).name}", file=sys.stderr)
    for name in sorted(found - wanted):
        print(f"wheel: {name} does not belong into {Path(wheel).name}", file=sys.stderr)
    return 0 if found == wanted and found else 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
