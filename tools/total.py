"""total.py BEGUN REPORT…: adds up pytest's JUnit reports into one line; exit status 1 if none passed or any failed.

BEGUN: when the tests began (s since the epoch).
"""

from __future__ import annotations

import sys
import time
import xml.etree.ElementTree as ET


def total(paths: list[str]) -> tuple[int, int, int]:
    """How many tests passed, failed (or could not run) and were skipped."""
    passed = failed = skipped = 0
    for path in paths:
        for suite in ET.parse(path).getroot().iter("testsuite"):
            wrong = int(suite.get("failures", 0)) + int(suite.get("errors", 0))
            left_out = int(suite.get("skipped", 0))
            passed += int(suite.get("tests", 0)) - wrong - left_out
            failed += wrong
            skipped += left_out
    return passed, failed, skipped


def main(begun: float, paths: list[str]) -> int:
    passed, failed, skipped = total(paths)
    minutes, seconds = divmod(int(time.time() - begun), 60)
    print(f"{passed} passed, {failed} failed, {skipped} skipped in {minutes} min {seconds} s")
    return 1 if failed or not passed else 0


if __name__ == "__main__":
    sys.exit(main(float(sys.argv[1]), sys.argv[2:]))
