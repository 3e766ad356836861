"""What one node that joins and leaves costs the others on ROS 2: datagrams on this host, and their processor time.

Bare rclpy nodes are idle in one domain. A process that has joined it creates a node with ROS's own endpoints, and
destroys it. Three ways in turns: with the discovery settings of `midstride up`; with the same, but a heartbeat in each
message about the graph; and with ROS's own settings on one host, where part of it goes over shared memory and is not
counted.

    python benchmarks/graph_messages.py --nodes 20 --rounds 5
"""

from __future__ import annotations

import argparse
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from midstride.backends.ros2 import dds_profiles

# How long each phase is counted (s). The others announce themselves meanwhile; the phase `rest` shows how much that is.
COUNTED = 1.5
# How long after each change all processes know of it, and are at rest again (s).
SETTLE = 8.0

IDLE = """
import rclpy, sys
rclpy.init()
node = rclpy.create_node(sys.argv[1])
print("up", flush=True)
rclpy.spin(node)
"""
JOINS = """
import rclpy, sys
rclpy.init()
hidden = rclpy.create_node("_joined", enable_rosout=False, start_parameter_services=False)
sys.stdin.readline()
node = rclpy.create_node("node")
print("joined", flush=True)
sys.stdin.readline()
node.destroy_node()
print("left", flush=True)
sys.stdin.readline()
"""
WAYS = ("midstride up", "heartbeat in each message", "ROS's own")


def settings(way: str, folder: Path) -> dict[str, str]:
    """The environment of the processes."""
    if way == "ROS's own":
        return dict(os.environ)
    environment = dds_profiles.tuned_environment(dict(os.environ))
    if way == "heartbeat in each message":
        variable = next(name for name in dds_profiles.PROFILE_VARIABLES.values() if name in environment)
        profile = Path(environment[variable])
        before = re.sub(r"\s*<qos>.*?</qos>", "", profile.read_text(), flags=re.DOTALL)
        environment[variable] = str(folder / profile.name)
        Path(environment[variable]).write_text(before)
    return environment


def received() -> int:
    """How many datagrams of UDP this host has received."""
    names, values = (
        line.split() for line in Path("/proc/net/snmp").read_text().splitlines() if line.startswith("Udp:")
    )
    return int(values[names.index("InDatagrams")])


def processor_time(processes: list[subprocess.Popen[str]]) -> float:
    """Of all their threads (ms)."""
    threads = (each for process in processes for each in Path(f"/proc/{process.pid}/task").glob("*/schedstat"))
    return sum(int(each.read_text().split()[0]) for each in threads) / 1e6


@contextmanager
def started(code: str, environment: dict[str, str], *arguments: str) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def measure(environment: dict[str, str], nodes: int) -> dict[str, tuple[int, float]]:
    """Datagrams and processor time (ms) of the others while a node joins, while it leaves, and for as long at rest."""
    with ExitStack() as stack:
        others = []
        for number in range(nodes):
            others.append(stack.enter_context(started(IDLE, environment, f"idle{number}")))
            assert others[-1].stdout is not None and others[-1].stdout.readline()
        joining = stack.enter_context(started(JOINS, environment))
        assert joining.stdin is not None and joining.stdout is not None
        time.sleep(SETTLE)
        found = {}
        for phase in ("joins", "leaves", "rest"):
            datagrams, taken = received(), processor_time(others)
            if phase != "rest":
                joining.stdin.write("\n")
                joining.stdin.flush()
                assert joining.stdout.readline()
            time.sleep(COUNTED)
            found[phase] = received() - datagrams, processor_time(others) - taken
            time.sleep(SETTLE)
        return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--nodes", type=int, default=20)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    os.environ.setdefault("ROS_DOMAIN_ID", "84")
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    rows: defaultdict[tuple[str, str], list[tuple[int, float]]] = defaultdict(list)
    with tempfile.TemporaryDirectory(prefix="ms") as folder:
        for _ in range(options.rounds):
            for way in WAYS:
                for phase, figures in measure(settings(way, Path(folder)), options.nodes).items():
                    rows[way, phase].append(figures)
    print(f"{options.nodes} idle nodes, medians of {options.rounds}, in {COUNTED} s each")
    for (way, phase), figures in rows.items():
        datagrams, taken = (statistics.median(column) for column in zip(*figures, strict=True))
        print(f"{way:26} {phase:7} {datagrams:7.0f} datagrams, processor time of the others {taken:6.1f} ms")


if __name__ == "__main__":
    main()
