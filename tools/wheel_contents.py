"""wheel_contents.py WHEEL: fails unless the wheel holds the package and the examples, and nothing else."""

from __future__ import annotations

import sys
import zipfile
from pathlib import Path

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


def main(wheel: str) -> int:
    with zipfile.ZipFile(wheel) as archive:
        found = {name for name in archive.namelist() if ".dist-info/" not in name}
    wanted = expected()
    for name in sorted(wanted - found):
        print(f"wheel: {name} is missing in {Path(wheel).name}", file=sys.stderr)
    for name in sorted(found - wanted):
        print(f"wheel: {name} does not belong into {Path(wheel).name}", file=sys.stderr)
    return 0 if found == wanted and found else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
