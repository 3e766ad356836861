"""total.py BEGUN REPORT…: adds up pytest's JUnit reports into one line; exit status 1 if none passed or any failed.

BEGUN: when the tests began (s since the epoch).
"""

from __future__ import annotations

import sys
import time
import xml.etree.ElementTree as ET
from collections import Counter
from pathlib import Path


def _round(path: str) -> int:
    """0 for ``suite.xml``, 1 for ``suite.1.xml``."""
    parts = Path(path).name.split(".")
    return int(parts[1]) if len(parts) > 2 else 0


def total(paths: list[str]) -> tuple[int, int, int]:
    """How many tests passed, failed (or could not run) and were skipped.

    A suite has a report for each round: ``suite.xml``, ``suite.1.xml``, …. A test counts as in its last round.
    """
    ends: dict[tuple[str, str, str], str] = {}
    for path in sorted(paths, key=_round):
        suite = Path(path).name.split(".")[0]
        tests: dict[tuple[str, str, str], str] = {}
        for case in ET.parse(path).getroot().iter("testcase"):
            test = (suite, case.get("classname", ""), case.get("name", ""))
            found = {child.tag for child in case}
            end = "failed" if found & {"failure", "error"} else "skipped" if "skipped" in found else "passed"
            tests[test] = "failed" if tests.get(test) == "failed" else end
        ends |= tests
    count = Counter(ends.values())
    return count["passed"], count["failed"], count["skipped"]


def main(begun: float, paths: list[str]) -> int:
    passed, failed, skipped = total(paths)
    minutes, seconds = divmod(int(time.time() - begun), 60)
    print(f"{passed} passed, {failed} failed, {skipped} skipped in {minutes} min {seconds} s")
    return 1 if failed or not passed else 0


if __name__ == "__main__":
    sys.exit(main(float(sys.argv[1]), sys.argv[2:]))
