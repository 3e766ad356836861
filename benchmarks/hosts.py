"""A system on two hosts beside one on one host: `up`, a replacement, and what an idle control link takes.

The hosts are network namespaces of this machine with a veth pair between them, and an SSH server in the second one
(tests/hosts/two_hosts.py). They share its processors, so that `up` is not shared out among two computers, as it is on
real ones. All is on ROS 2, and what is compared takes turns:

    up, two hosts      `midstride up` of components that never write, half of them on each host
    up, one host       the same components, all on the manager's host
    to arm             `replace NODE --on arm`: a node that counts at 50 Hz moves there, with its state
    on arm             it is replaced there by another component
    to manager         it moves back
    on manager         it is replaced there
    nothing            nothing is done for two seconds: the jitter of the machine

A bare recorder on each host hears the node. A gap is the longest silence from the beginning of the command to its end,
in periods of 20 ms; missed and twice are determined from what it has counted.

The idle link is that of the last `up`: the processor time of the manager, of the host process and of SSH, the bytes of
the SSH connection (segments with 66 bytes of headers each), and all bytes of the interface, which carries the
middleware's as well.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import _control_plane_worker as worker
from _guard import guard, inside, remove_at_end

HERE = Path(__file__).resolve().parent
sys.path.append(str(HERE.parent))  # for tests.hosts

# The tests have the domains from 1 to 100.
DOMAIN = "101"
# How long after `up` the idle time begins (s): until then the middleware acknowledges what it has discovered.
SETTLE = 10.0
# After a command, for what is on its way (s).
ON_ITS_WAY = 0.3
# Of Ethernet, IP and TCP with time stamps.
HEADERS = 66
OTHER = '\ncomponent OtherCounter like Counter { run "python3 ./_counter.py" }\n'
KINDS = ("to arm", "on arm", "to manager", "on manager", "nothing")

Row = dict[str, Any]


# -- up, and the idle link ---------------------------------------------------------------------------------


def chain(system: str, nodes: int, there: int) -> str:
    """Components in a row that never write, the last ``there`` of them on the host `arm`."""
    lines = [f"topic /t{index} : Text" for index in range(nodes)]
    for index in range(nodes):
        on = " on arm" if index >= nodes - there else ""
        component, source = ("Link", f"in <- /t{index - 1}\n") if index else ("Head", "")
        lines.append(f"node n{index} : {component}{on} {{ {source} out -> /t{index} }}")
    return worker.specification_text("\n".join(lines)).strip().replace("control_plane_benchmark", system)


def bring_up(robot: Any, kind: str) -> Row:
    from tests.hosts.two_hosts import traffic

    load, before, begun = os.getloadavg()[0], traffic(robot.hosts.near), time.monotonic()
    done = robot("up", robot.file, "--detach", timeout=300)
    took = time.monotonic() - begun
    assert done.status == 0, done.out + done.err
    return {"kind": kind, "load": load, "s": took, "interface, kB": (traffic(robot.hosts.near) - before) / 1000}


def commands(namespace: str, name: str) -> list[int]:
    """The processes of a namespace whose command begins with ``name``."""
    found = inside([Path("/run/netns", namespace)])
    return [pid for pid in found if Path(f"/proc/{pid}/comm").read_text().startswith(name)]


def of_ssh(namespace: str) -> int:
    """The bytes of the SSH connections from a namespace so far, both ways, with their headers."""
    words = ["nsenter", f"--net=/run/netns/{namespace}", "ss", "-tinOH", "dport", "=", ":22"]
    text = subprocess.run(words, check=True, capture_output=True, text=True).stdout
    counts = re.findall(r"\b(bytes_sent|bytes_received|segs_out|segs_in):(\d+)", text)
    assert counts, text
    return sum(int(count) * (HEADERS if name.startswith("segs") else 1) for name, count in counts)


def idle(robot: Any, kind: str, seconds: float) -> Row:
    """Of a system that is up: processor time in % of a core, traffic in kB/s."""
    from tests.hosts.two_hosts import traffic

    hosts = robot.hosts
    processes = {"manager": [robot.manager]}
    if kind == "two hosts":
        processes |= {"host process": [robot.host_process]}
        processes |= {"ssh": commands(hosts.near, "ssh"), "sshd": commands(hosts.far, "sshd")}
    time.sleep(SETTLE)

    def read() -> dict[str, float]:
        found = {f"{name}, % of a core": 100 * worker.processor_time(pids) for name, pids in processes.items()}
        if kind == "two hosts":
            found["SSH connection, kB/s"] = of_ssh(hosts.near) / 1000
        return found | {"interface, kB/s": traffic(hosts.near) / 1000}

    load, before, begun = os.getloadavg()[0], read(), time.monotonic()
    time.sleep(seconds)
    after, took = read(), time.monotonic() - begun
    return {"kind": f"idle, {kind}", "load": load} | {
        name: (value - before[name]) / took for name, value in after.items()
    }


def measure_up(folder: Path, rounds: int, nodes: int, seconds: float) -> list[Row]:
    from tests.hosts.robots import robots

    rows: list[Row] = []
    with robots(folder, chain("twohosts", nodes, nodes // 2)) as two:
        one = dataclasses.replace(two, system="onehost", text=chain("onehost", nodes, 0))
        kinds = {"two hosts": two, "one host": one}
        for number in range(rounds):
            taken = {}
            for kind in sorted(kinds, reverse=bool(number % 2)):
                robot = kinds[kind]
                row = bring_up(robot, f"up, {kind}")
                taken[kind] = row["s"]
                show(rows, row)
                if number == rounds - 1 and seconds:
                    show(rows, idle(robot, kind, seconds))
                down = robot("down", "--system", robot.system, timeout=120)
                assert down.status == 0, down.out + down.err
            show(rows, {"kind": "up, two hosts / one host", "ratio": taken["two hosts"] / taken["one host"]})
    return rows


# -- replacements ------------------------------------------------------------------------------------------


def gap(heard: Any, begun: float, ended: float) -> float:
    """The longest silence between two messages of which one was heard meanwhile, in periods."""
    from tests.hosts.counting import RATE

    times = [each.heard for each in heard.read().rows]
    return max(two - one for one, two in pairwise(times) if two >= begun and one <= ended) * RATE


def replaced(robot: Any, heard: dict[str, Any], kind: str, component: str) -> Row:
    load, begun = os.getloadavg()[0], time.monotonic()
    row: Row = {"kind": kind, "load": load}
    if kind == "nothing":
        time.sleep(2.0)
    else:
        way, _, host = kind.partition(" ")
        words = ["--on", host] if way == "to" else [component]
        done = robot("replace", "counter", *words, "--yes", "--json")
        row |= {"s": time.monotonic() - begun, "outcome": done.json["outcome"] if done.out else done.err}
    ended = time.monotonic()
    time.sleep(ON_ITS_WAY)
    return row | {f"gap, {host}": gap(each, begun, ended) for host, each in heard.items()}


def measure_replacements(folder: Path, moves: int) -> list[Row]:
    from tests.hosts.counting import SPECIFICATION, counting

    rows: list[Row] = []
    with counting(folder, SPECIFICATION + OTHER) as (robot, heard):
        for _ in range(moves // 2):
            components = iter(("OtherCounter", "Counter"))
            for kind in KINDS:
                show(rows, replaced(robot, heard, kind, next(components) if kind.startswith("on") else ""))
        for host, each in heard.items():
            numbers = [message.number for message in each.read().rows]
            present = set(numbers)
            missed = len(set(range(numbers[0], max(numbers) + 1)) - present)
            disorder = sum(two < one for one, two in pairwise(numbers))
            counted = {"messages": len(numbers), "missed": missed, "twice": len(numbers) - len(present)}
            show(rows, {"kind": f"heard, {host}"} | counted | {"out of order": disorder})
    return rows


# --------------------------------------------------------------------------------------------------------


def show(rows: list[Row], row: Row) -> None:
    """Print a row, and add it to ``rows``."""
    rows.append(row)
    named = {name: f"{value:.2f}" if isinstance(value, float) else value for name, value in row.items()}
    print(named.pop("kind"), *(f"{name} {value}" for name, value in named.items()), sep=", ")
    sys.stdout.flush()


def summary(rows: list[Row]) -> None:
    """Median and greatest of each figure of each kind; what happened once is in the rows."""
    print(f"\n{'median, greatest':<28}{'rows':>5}{'load':>13}{'time, s':>16}{'gap, periods':>16}{'ratio':>13}")
    for kind in dict.fromkeys(row["kind"] for row in rows):
        of_kind = [row for row in rows if row["kind"] == kind]
        gaps = [value for row in of_kind for name, value in row.items() if name.startswith("gap")]
        columns = [[row[name] for row in of_kind if name in row] for name in ("load", "s", "ratio")]
        columns.insert(2, gaps)
        if len(of_kind) > 1:
            cells = [f"{statistics.median(each):.2f}, {max(each):.2f}" if each else "" for each in columns]
            widths = (13, 16, 16, 13)
            print(f"{kind:<28}{len(of_kind):>5}" + "".join(f"{c:>{w}}" for c, w in zip(cells, widths, strict=True)))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--nodes", type=int, default=30, help="of `up`, on all hosts")
    parser.add_argument("--ups", type=int, default=5, help="of each kind")
    parser.add_argument("--idle", type=float, default=20.0, help="how long the idle link is watched (s)")
    parser.add_argument("--moves", type=int, default=20, help="and as many replacements on a host")
    parser.add_argument("--out", type=Path, default=HERE / "results" / "hosts.json")
    options = parser.parse_args()
    from tests.hosts.two_hosts import missing

    if (why := missing()) is not None:
        print(f"not measured: two hosts cannot be had here: {why}")
        return 0
    guard()
    os.environ["ROS_DOMAIN_ID"] = DOMAIN
    rows: list[Row] = []
    with tempfile.TemporaryDirectory(prefix="ms") as name:
        remove_at_end(Path(name))
        tempfile.tempdir = name  # what the hosts need goes there as well
        files = Path(name) / "none"
        files.mkdir()
        print(f"load before: {os.getloadavg()[0]:.1f}")
        if options.ups:
            rows += measure_up(files, options.ups, options.nodes, options.idle)
        if options.moves:
            rows += measure_replacements(Path(name), options.moves)
    summary(rows)
    options.out.parent.mkdir(exist_ok=True)
    options.out.write_text(json.dumps(rows, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
