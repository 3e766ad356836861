"""The machine and the software of a measurement, for the first line of its file."""

from __future__ import annotations

import os
import platform
import subprocess
from importlib import metadata
from pathlib import Path
from typing import Any

import midstride

ROOT = Path(__file__).resolve().parents[2]


def described(backend: str) -> dict[str, Any]:
    """Processors, memory, kernel, and the versions of what is measured, as far as they can be known."""
    import psutil

    return {
        "processor": _processor(),
        "processors": os.cpu_count(),
        "memory_gib": round(psutil.virtual_memory().total / 2**30, 1),
        "kernel": platform.release(),
        "python": platform.python_version(),
        "midstride": midstride.__version__,
        "commit": _commit(),
        "ros": _ros(backend),
    }


def _processor() -> str | None:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return None
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), None)


def _commit() -> str | None:
    command = ["git", "-C", str(ROOT), "describe", "--always", "--dirty"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError:
        return None
    return done.stdout.strip() or None


def _ros(backend: str) -> dict[str, str | None]:
    if backend == "ros1":
        return {"distribution": "ROS 1"}
    import rclpy

    found = {"distribution": os.environ.get("ROS_DISTRO"), "middleware": rclpy.get_rmw_implementation_identifier()}
    for name in ("ros-jazzy-rclpy", "rclpy"):
        try:
            found["rclpy"] = metadata.version(name)
            break
        except metadata.PackageNotFoundError:
            continue
    return found
