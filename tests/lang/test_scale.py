"""What a check costs grows with the text alone; benchmarks/check.py says how long that takes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

from midstride.lang import load_text
from tests.large_systems import chain


def calls(nodes: int) -> int:
    """How many calls of Python functions it takes to check a chain of that many nodes."""
    text, count = chain(nodes), 0

    def counting(frame: Any, event: str, argument: Any) -> None:
        nonlocal count
        count += event == "call"

    sys.setprofile(counting)
    try:
        loaded = load_text(text)
    finally:
        sys.setprofile(None)
    assert loaded.specification is not None
    return count


def test_the_work_grows_with_the_text() -> None:
    calls(10)  # what is made once and kept
    small, large = calls(100), calls(800)
    assert large < 8 * 1.1 * small


def test_a_check_imports_only_what_it_needs(tmp_path: Path) -> None:
    """Start-up is half of the time: each of these would double it."""
    file = tmp_path / "small.stride"
    file.write_text(chain(3), encoding="utf-8")
    heavy = {"asyncio", "fastapi", "httpx", "jinja2", "jsonschema", "pydantic", "rclpy", "rich", "rospy", "z3"}
    script = f"""if True:
        import sys
        from midstride.cli import main
        status = main(["check", {str(file)!r}])
        print(status, sorted({heavy!r} & set(sys.modules)))
    """
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "0 []"
