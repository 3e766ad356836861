"""Launch files in Python. They are programs, so they are carried out only if the user says so, in their own process."""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from midstride.launch_files.findings import UnknownValue
from midstride.launch_files.own_session import TIMEOUT, run_command

RUNNER: Final = (sys.executable, "-m", "midstride.backends.ros2.manager.python_launch")
_NO_LAUNCH: Final = 3


def carried_out(
    path: str,
    given: Mapping[str, Any],
    environment: Mapping[str, str],
    runner: Sequence[str] = RUNNER,
    timeout: float = TIMEOUT,
) -> dict[str, Any]:
    """Return what a launch file in Python starts, what was left out, and what holds after it.

    ``given``: what holds where it is included. Raises UnknownValue with the reason.
    """
    with tempfile.TemporaryDirectory(prefix="midstride-") as folder:
        exchange = Path(folder, "exchange.json")
        exchange.write_text(json.dumps(dict(given)), encoding="utf-8")
        # What launch_ros and the file itself write to temporary files goes with the folder.
        own = {**environment, "TMPDIR": folder, "ROS_LOG_DIR": folder}
        try:
            status, _, errors = run_command([*runner, path, str(exchange)], own, timeout)
        except (TimeoutError, ValueError) as error:
            raise UnknownValue(str(error), "python") from None
        last = (errors.strip().splitlines() or [f"exit status {status}"])[-1]
        if status == _NO_LAUNCH:
            remedy = "source the setup file of your ROS"
            raise UnknownValue(f"ROS's `launch` cannot be imported ({last}); {remedy}", "python")
        if status != 0:
            raise UnknownValue(f"it failed: {last}", "python")
        found: dict[str, Any] = json.loads(exchange.read_text(encoding="utf-8"))
        if "processes" not in found:  # what was given is still there
            raise UnknownValue(f"it has ended the process that carried it out, with status {status}", "python")
        return found
