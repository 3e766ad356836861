"""How often the discovery of a ROS 2 process stops for good while its peers come and go (eProsima/Fast-DDS#6502).

Fast DDS can deadlock in a process whose peers come and go: its event thread waits for a thread that waits for it, and
from then on the process matches nobody new. Here some processes stay, while publishers start and end as fast as this
machine can. Of each that stays, the context switches of its event thread are counted (it has stopped if there are none
for STILL seconds), and in the end a new publisher has to be matched with every subscriber.

Compares the discovery settings and the endpoints of this checkout with those of an earlier one, ``--against DIR``,
whose control plane was made of ROS services, in turns.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from control_plane import HERE, environment

NODES = HERE / "_discovery_nodes.py"
WATCHED = 3
# Without a context switch for so long (s), the event thread has stopped.
STILL = 10.0
_TUNED = """
import json, os
try:
    from midstride.backends.ros2.dds_profiles import tuned_environment
except ImportError:
    from midstride.backends.ros2.tuning import tuned_environment
print(json.dumps(tuned_environment(dict(os.environ))))
"""


def tuned(checkout: Path, python: str, domain: int) -> dict[str, str]:
    """The environment in which ``checkout`` starts components."""
    base = {**environment(checkout, "ros2"), "ROS_DOMAIN_ID": str(domain)}
    found = subprocess.run([python, "-c", _TUNED], env=base, check=True, capture_output=True, text=True)
    chosen: dict[str, str] = json.loads(found.stdout.splitlines()[-1])
    return {**base, **{name: value for name, value in chosen.items() if name.startswith(("FAST", "ROS_AUTO"))}}


def switches(pid: int) -> int | None:
    """The voluntary context switches of a process's event threads so far; None where it has none."""
    total = None
    for task in Path(f"/proc/{pid}/task").iterdir():
        try:
            if not (task / "comm").read_text().startswith("dds.ev."):
                continue
            status = (task / "status").read_text()
        except OSError:
            continue
        total = (total or 0) + int(status.split("\nvoluntary_ctxt_switches:")[1].split()[0])
    return total


def segment(python: str, env: dict[str, str], services: bool, seconds: float) -> dict[str, Any]:
    """One stretch of time: how many peers came and went, which processes stopped, and who is matched in the end."""
    kind = "services" if services else "none"

    def start(*words: str, **options: Any) -> subprocess.Popen[str]:
        return subprocess.Popen([python, str(NODES), *words], env=env, text=True, **options)

    staying = {f"watched_{n}": start("watched", f"watched_{n}") for n in range(WATCHED)}
    staying["manager"] = start("manager", kind)
    rates: list[float] = []
    stopped: set[str] = set()
    churn = None
    try:
        time.sleep(3.0)
        churn = start("peers", kind, str(seconds), stdout=subprocess.PIPE)
        counts = {name: switches(process.pid) or 0 for name, process in staying.items()}
        since = {name: time.monotonic() for name in staying}
        settled = time.monotonic() + STILL + 2.0  # watched a little longer than peers come and go
        while churn.poll() is None or time.monotonic() < settled:
            if churn.poll() is None:
                settled = time.monotonic() + STILL + 2.0
            time.sleep(1.0)
            for name, process in staying.items():
                if process.poll() is not None:
                    raise SystemExit(f"{name} has exited with status {process.returncode}")
                now = switches(process.pid) or 0
                rates.append(now - counts[name])
                if now != counts[name]:
                    since[name] = time.monotonic()
                elif time.monotonic() - since[name] > STILL:
                    stopped.add(name)
                counts[name] = now
        assert churn.stdout is not None
        peers = int(churn.stdout.read().split()[-1])
        probed = start("probe", str(WATCHED), stdout=subprocess.PIPE)
        matched = int(probed.communicate(timeout=60)[0].split()[-1])
    finally:
        for process in [*staying.values(), *filter(None, [churn])]:
            process.kill()
            process.wait()
    return {"peers": peers, "stopped": sorted(stopped), "unmatched": WATCHED - matched, "switches": rates}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--against", type=Path, metavar="DIR", help="a checkout of an earlier version")
    parser.add_argument("--minutes", type=float, default=10.0, help="how long peers come and go, all in all")
    parser.add_argument("--segment", type=float, default=60.0, help="how long with the same processes (s)")
    parser.add_argument("--out", type=Path, default=HERE / "results" / "discovery_deadlock.json")
    options = parser.parse_args()
    domain = int(os.environ.get("ROS_DOMAIN_ID", "88"))
    versions = {"new": (sys.executable, tuned(HERE.parent, sys.executable, domain), False)}
    if options.against is not None:
        python = str(options.against.resolve() / ".venv" / "bin" / "python")
        old = (python, tuned(options.against.resolve(), python, domain), True)
        versions = {"old": old, **versions}
    found: dict[str, list[dict[str, Any]]] = {version: [] for version in versions}
    turns = max(1, round(60 * options.minutes / options.segment / len(versions)))
    for _ in range(turns):
        for version, (python, env, services) in versions.items():
            row = segment(python, env, services, options.segment)
            found[version].append(row)
            words = f"{row['peers']} peers, stopped: {', '.join(row['stopped']) or 'none'}"
            print(f"  {version}: {words}, not matched: {row['unmatched']}", file=sys.stderr, flush=True)
    head = ("peers", "stopped", "not matched", "of processes", "event thread, switches/s: median", "least")
    print(f"{'':6}" + "".join(f"{word:>{len(word) + 3}}" for word in head))
    for version, rows in found.items():
        rates = [rate for row in rows for rate in row["switches"]]
        cells = (
            sum(row["peers"] for row in rows),
            sum(len(row["stopped"]) for row in rows),
            sum(row["unmatched"] for row in rows),
            len(rows) * (WATCHED + 1),
            f"{statistics.median(rates):.0f}",
            f"{min(rates):.0f}",
        )
        print(f"{version:6}" + "".join(f"{cell:>{len(word) + 3}}" for cell, word in zip(cells, head, strict=True)))
    options.out.parent.mkdir(exist_ok=True)
    options.out.write_text(json.dumps(found) + "\n")


if __name__ == "__main__":
    main()
