"""A change on eight robots: rolled out by the playbook of the collection, beside `down` and `up` by plain Ansible.

The robots are network namespaces of this machine with an SSH server each, and a talker and a listener on ROS 2 at 10 Hz
(tests/fleet/robots.py). They and the operator share its processors, so that robots of a batch slow each other down, as
real ones do not. Each way takes its turn in each round, with connections of its own:

    plain            `midstride down`, then `midstride up`, one robot after another
    one-by-one       the playbook, one robot after another
    batches          the playbook as it is: one robot, a tenth, all
    pipelining       the same with Ansible's pipelining
    nothing-to-do    the playbook with pipelining, all at once, when all robots have the change

Nothing is watched afterwards: that takes the time that is asked for. `silence` is the longest gap at the listener, and
of the plain way the time from the beginning of `down` to the end of `up`. Traffic is counted at the robot's interface.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from _guard import guard

HERE = Path(__file__).resolve().parent
sys.path.append(str(HERE.parent))  # for tests.fleet

KINDS = ("plain", "one-by-one", "batches", "pipelining", "nothing-to-do")
FIRST_DOMAIN = 61
PIPELINING = {"ANSIBLE_PIPELINING": "1"}
PLAIN = """
- name: Stop and start
  hosts: all
  gather_facts: false
  serial: 1
  max_fail_percentage: 0
  environment: "{{ midstride_environment }}"
  tasks:
    - ansible.builtin.shell: ". {{ midstride_setup[0] }}; midstride down"
      register: down
    - ansible.builtin.shell: ". {{ midstride_setup[0] }}; midstride up {{ file }} --detach"
      register: up
    - ansible.builtin.copy:
        content: "{{ {'down': down, 'up': up} | to_json }}"
        dest: "{{ reports }}/{{ inventory_hostname }}.json"
      delegate_to: localhost
"""


def seconds_between(begin: str, end: str) -> float:
    """Between two times as Ansible's `command` returns them."""
    from datetime import datetime

    return (datetime.fromisoformat(end) - datetime.fromisoformat(begin)).total_seconds()


def silence(kind: str, reports: list[dict[str, Any]]) -> float | None:
    """The longest time without a message at a listener (s); None: nothing was changed."""
    if kind == "plain":
        return max(seconds_between(each["down"]["start"], each["up"]["end"]) for each in reports)
    if kind == "nothing-to-do":
        return None
    swaps = [swap for each in reports for swap in each["applied"]["report"]["swaps"]]
    assert len(swaps) == len(reports)
    return max(float(swap["gap"]) for swap in swaps)


def measure(robots: Any, kind: str, file: Path, number: int) -> dict[str, Any]:
    """One row: all robots get ``file``."""
    count = len(robots.robots)
    pipelining = PIPELINING if kind in ("pipelining", "nothing-to-do") else {}
    environment = {**pipelining, "ANSIBLE_HOME": str(robots.folder / f"a{number}")}  # no connection is there yet
    reports = robots.folder / "reports"
    reports.mkdir(exist_ok=True)
    given: dict[str, Any] = {"file": str(file), "reports": str(reports), "watch_seconds": 0}
    if kind == "plain":
        play = robots.folder / "plain.yml"
        play.write_text(PLAIN)
        name = str(play)
    else:
        name = "midstride.fleet.rollout"
        given |= {"batches": {"one-by-one": [1], "nothing-to-do": ["100%"]}.get(kind, [1, "10%", "100%"])}
    before = [robot.traffic() for robot in robots.robots]
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    begun = time.monotonic()
    words = ("ansible-playbook", name, "-f", str(count), "-e", json.dumps(given))
    done = robots.ansible(*words, environment=environment)
    took = time.monotonic() - begun
    now = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert done.returncode == 0, done.stdout + done.stderr
    traffic = [robot.traffic() - then for robot, then in zip(robots.robots, before, strict=True)]
    found = [robots.report(robot) for robot in robots.robots]
    return {
        "kind": kind,
        "load": os.getloadavg()[0],
        "seconds": took,
        "operator's processor time a robot, s": (now.ru_utime + now.ru_stime - used.ru_utime - used.ru_stime) / count,
        "kB a robot": statistics.median(traffic) / 1000,
        "silence, s": silence(kind, found),
    }


def show(rows: list[dict[str, Any]]) -> None:
    names = ("seconds", "of the first of its round", "operator's processor time a robot, s", "kB a robot", "silence, s")
    print(f"\n{'median':<15}" + "".join(f"{name:>38}" for name in names))
    for kind in KINDS:
        of_kind = [row for row in rows if row["kind"] == kind]
        if of_kind:
            values = [[row[name] for row in of_kind if row[name] is not None] for name in names]
            print(
                f"{kind:<15}" + "".join(f"{statistics.median(each):>38.2f}" if each else f"{'':>38}" for each in values)
            )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int, default=8)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--kinds", choices=KINDS, nargs="+", default=list(KINDS))
    parser.add_argument("--out", type=Path, default=HERE / "results" / "fleet.json")
    options = parser.parse_args()
    from tests.fleet.robots import ROOT, fleet, new_program, release
    from tests.hosts.two_hosts import missing

    if (why := missing()) is not None:
        print(f"not measured: no robots with a network each can be had here: {why}")
        return 0
    if not (ROOT / ".venv-ansible").exists():
        print("not measured: ansible-core is not installed (`make ansible`)")
        return 0
    guard()
    folder = Path(tempfile.mkdtemp(prefix="ms"))
    rows: list[dict[str, Any]] = []
    try:
        with fleet(folder, range(FIRST_DOMAIN, FIRST_DOMAIN + options.robots)) as robots:
            robots.up()
            files = [
                release(folder, name, new_program().replace("good news", f"{name} news")) for name in ("odd", "even")
            ]
            number = 0
            for _ in range(options.rounds):
                for kind in options.kinds:
                    position = len(rows) % len(options.kinds)
                    if kind != "nothing-to-do":
                        number += 1
                    rows.append(measure(robots, kind, files[number % 2], len(rows)))
                    rows[-1]["of the first of its round"] = rows[-1]["seconds"] / rows[-1 - position]["seconds"]
                    print(", ".join(f"{k} {v:.2f}" if isinstance(v, float) else f"{v}" for k, v in rows[-1].items()))
                    sys.stdout.flush()
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    show(rows)
    options.out.parent.mkdir(exist_ok=True)
    options.out.write_text(json.dumps(rows, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
