"""total.py REPORT…: adds up pytest's JUnit reports into one line; exit status 1 where none passed or any failed."""

from __future__ import annotations

import sys
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


def main(paths: list[str]) -> int:
    passed, failed, skipped = total(paths)
    print(f"{passed} passed, {failed} failed, {skipped} skipped")
    return 1 if failed or not passed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
