"""``python tools/lowest.py``: prints the lowest version that pyproject.toml allows of each dependency, for pip."""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def lowest() -> list[str]:
    """Each as `name==version`. Raises ValueError for a dependency without a lower bound."""
    # Python 3.10 has no tomllib; a list of strings is written in TOML as it is in Python.
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    listed = re.search(r"^dependencies = (\[.*?^\])", text, re.MULTILINE | re.DOTALL)
    assert listed is not None
    found = []
    for requirement in ast.literal_eval(listed[1]):
        line, _, marker = requirement.partition(";")
        match = re.match(r"([\w-]+)>=([\w.]+)", line.strip())
        if match is None:
            raise ValueError(f"{requirement} has no lower bound")
        found.append(f"{match[1]}=={match[2]}" + (f" ; {marker.strip()}" if marker else ""))
    return found


if __name__ == "__main__":
    sys.stdout.write("\n".join(lowest()) + "\n")
