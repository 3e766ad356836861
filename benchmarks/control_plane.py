"""What the control plane takes, on real ROS 2 and ROS 1: starts, round trips, replacements, many nodes, paused ones.

Measures the code of the checkout that it is in. With ``--against DIR``, another checkout with a virtual environment
``DIR/.venv``, of an earlier version, is measured in the same run by its own worker, the two in turns. Each run of a
scenario is a manager's process with components of its own (_control_plane_worker.py).
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import uuid
from pathlib import Path
from typing import Any

import psutil
from _guard import guard

HERE = Path(__file__).resolve().parent
MARK = "MIDSTRIDE_BENCHMARK_RUN"
LIMIT = 900.0


def environment(checkout: Path, backend: str) -> dict[str, str]:
    """As it was before this Python put its own ROS 2 on the paths, with the sources of ``checkout`` first."""
    kept = {name: value for name, value in os.environ.items() if name != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}
    for name in ("PYTHONPATH", "LD_LIBRARY_PATH", "AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH"):
        parts = [part for part in kept.pop(name, "").split(os.pathsep) if part and not _is_ours(Path(part))]
        if name == "PYTHONPATH":
            parts.insert(0, str(checkout / "src"))
        if parts:
            kept[name] = os.pathsep.join(parts)
    kept["MIDSTRIDE_REGISTRATION_TIMEOUT"] = "300"
    kept.setdefault("ROS_DOMAIN_ID", "87")
    kept.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if backend == "ros1":
        with socket.create_server(("127.0.0.1", 0)) as free:
            kept["ROS_MASTER_URI"] = f"http://127.0.0.1:{free.getsockname()[1]}"
    return kept


def _is_ours(path: Path) -> bool:
    return path.is_relative_to(sys.prefix) or path.is_relative_to(HERE.parent)


def run(version: str, checkout: Path, scenario: str, backend: str, options: argparse.Namespace) -> Any:
    """The samples of one run; None where it failed. Whatever it started has ended then."""
    old = version == "old"
    python = str(checkout / ".venv" / "bin" / "python") if old else sys.executable
    mark = uuid.uuid4().hex
    nodes = options.paused if scenario == "paused" else options.nodes
    seconds = 10.0 if scenario == "paused" else options.idle
    command = [python, str(checkout / "benchmarks" / "_control_plane_worker.py"), scenario, "--backend", backend]
    command += ["--times", str(options.times), "--nodes", str(nodes), "--seconds", str(seconds)]
    with tempfile.TemporaryDirectory(prefix="ms") as home:
        try:
            done = subprocess.run(
                command,
                env={**environment(checkout, backend), MARK: mark, "ROS_LOG_DIR": home},
                cwd=checkout / "benchmarks",
                stdout=subprocess.PIPE,
                timeout=LIMIT,
                start_new_session=True,
            )
        except subprocess.TimeoutExpired:
            print(f"  {backend} {scenario} {version}: not done within {LIMIT:g} s", flush=True)
            return None
        finally:
            _end(mark)
    if done.returncode:
        print(f"  {backend} {scenario} {version}: failed", flush=True)
        return None
    return json.loads(done.stdout.splitlines()[-1])


def _end(mark: str) -> None:
    """End what bears ``mark`` in its environment."""
    for process in psutil.process_iter():
        try:
            if process.environ().get(MARK) == mark:
                process.send_signal(signal.SIGKILL)
        except psutil.Error:
            continue


def described(figure: str, samples: list[float]) -> list[tuple[str, float, float, float]]:
    """The rows of a figure: what, median, least, greatest; round trips have a p99."""
    ordered = sorted(samples)
    if figure == "round trip":
        p99 = ordered[len(ordered) * 99 // 100]
        return [
            ("round trip, p50", statistics.median(ordered), ordered[0], ordered[-1]),
            ("round trip, p99", p99, ordered[0], ordered[-1]),
        ]
    return [(figure, statistics.median(ordered), ordered[0], ordered[-1])]


def shown(figure: str, value: float) -> str:
    if figure.endswith("% of a core"):
        return f"{value:.1f} %"
    if figure.endswith("number"):
        return f"{value:g}"
    return f"{value * 1000:.2f} ms" if value < 0.01 else f"{value * 1000:.0f} ms" if value < 10 else f"{value:.1f} s"


def table(backend: str, found: dict[str, dict[str, list[float]]]) -> None:
    """``found``: version -> figure -> samples."""
    versions = list(found)
    heads = "".join(f"{version + ': median (least, greatest)':>42}" for version in versions)
    print(f"{backend:<55}{heads}{'old/new':>10}" if len(versions) > 1 else f"{backend:<55}{heads}")
    for figure in found["new"]:
        rows = {v: described(figure, found[v][figure]) for v in versions if found[v].get(figure)}
        for index, (name, median, _, _) in enumerate(rows["new"]):
            line = f"{name:<55}"
            for version in versions:
                if version not in rows:
                    line += f"{'-':>42}"
                    continue
                _, middle, least, most = rows[version][index]
                text = f"{shown(figure, middle)} ({shown(figure, least)}, {shown(figure, most)})"
                line += f"{text:>42}"
            if "old" in rows and median:
                line += f"{rows['old'][index][1] / median:>10.2f}"
            print(line, flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--against", type=Path, metavar="DIR", help="a checkout of an earlier version")
    parser.add_argument("--backends", nargs="+", default=["ros2", "ros1"], choices=("ros2", "ros1"))
    parser.add_argument("--scenarios", nargs="+", default=["first", "life", "many", "bare", "paused"])
    parser.add_argument("--rounds", type=int, default=3, help="runs of each scenario and version")
    parser.add_argument("--times", type=int, default=10, help="starts, restarts and replacements in one run")
    parser.add_argument("--nodes", type=int, default=30, help="nodes of `up`, and idle ones")
    parser.add_argument("--idle", type=float, default=20.0, help="how long the idle ones are watched (s)")
    parser.add_argument("--paused", type=int, default=100, help="components that are stopped for 10 s")
    parser.add_argument("--out", type=Path, default=HERE / "results" / "control_plane.json")
    options = parser.parse_args()
    guard()
    versions = {"new": HERE.parent}
    if options.against is not None:
        versions = {"old": options.against.resolve(), **versions}
    document: dict[str, Any] = json.loads(options.out.read_text()) if options.out.exists() else {}
    for backend in options.backends:
        if backend == "ros1" and not _has_ros1():
            print("ROS 1 was not found (tools/ros1 says why): left out")
            continue
        found: dict[str, dict[str, list[float]]] = {version: {} for version in versions}
        for scenario in options.scenarios:
            for _ in range(options.rounds):
                for version, checkout in versions.items():
                    if scenario == "bare" and version == "old":
                        continue
                    samples = run(version, checkout, scenario, backend, options) or {}
                    for figure, values in samples.items():
                        found[version].setdefault(figure, []).extend(values)
        table(backend, found)
        for version, figures in found.items():
            document.setdefault(backend, {}).setdefault(version, {}).update(figures)
    options.out.parent.mkdir(exist_ok=True)
    options.out.write_text(json.dumps(document, indent=1) + "\n")


def _has_ros1() -> bool:
    from midstride.backends.ros1 import launching

    return launching.interpreter() is not None


if __name__ == "__main__":
    main()
