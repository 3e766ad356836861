"""Launch files in Python. They are programs, so they are carried out only if the user says so, in their own process."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from midstride.launch_files.findings import UnknownValue

RUNNER: Final = (sys.executable, "-m", "midstride.backends.ros2.manager.python_launch")
TIMEOUT: Final = 60.0
_NO_LAUNCH: Final = 3


def carried_out(
    path: str,
    variables: Mapping[str, str],
    namespace: str,
    environment: Mapping[str, str],
    runner: Sequence[str] = RUNNER,
) -> dict[str, Any]:
    """The nodes of a launch file in Python, and what was left out. Raises UnknownValue with the reason."""
    with tempfile.TemporaryDirectory(prefix="midstride-") as folder:
        exchange = Path(folder, "exchange.json")
        exchange.write_text(json.dumps({"variables": dict(variables), "namespace": namespace}), encoding="utf-8")
        try:
            done = subprocess.run(
                [*runner, path, str(exchange)],
                env={**os.environ, **environment},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
                errors="replace",
                timeout=TIMEOUT,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise UnknownValue(f"it has not ended within {TIMEOUT:g} s", "python") from None
        last = (done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1]
        if done.returncode == _NO_LAUNCH:
            raise UnknownValue(
                f"ROS's `launch` cannot be imported ({last}); source the setup file of your ROS", "python"
            )
        if done.returncode != 0:
            raise UnknownValue(f"it failed: {last}", "python")
        found: dict[str, Any] = json.loads(exchange.read_text(encoding="utf-8"))
        return found
