"""Against Fast Downward (A* with LM-cut) through unified-planning: the least disruption of small replacements.

The changes are of the same family as the published conflict cores (``_conflict_core_systems``), with 3 to 6 nodes to
replace instead of 18 to 26. How they are put as a classical problem: ``_fast_downward_problem``. Both ways have to
agree on the least disruption. Times are those of the processor; Fast Downward's include its translation, not the
encoding in Python.

It needs ``unified-planning`` and ``up-fast-downward`` in an environment made for it, beside what Midstride needs:

    python3 -m venv /tmp/fast-downward
    /tmp/fast-downward/bin/pip install unified-planning up-fast-downward immutables msgspec
    PYTHONPATH=src /tmp/fast-downward/bin/python benchmarks/fast_downward.py
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import resource
import signal
import statistics
import sys
import time
from collections import defaultdict
from importlib.util import find_spec
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from _conflict_core_systems import instance
from conflict_cores import planned, seconds_of_children

from midstride.model.specification import initial
from midstride.plan.change import Change
from midstride.plan.change_builder import change_between

TIED, FUNCTIONALITIES = 20, 10


def small(seed: int) -> Change | None:
    """None for seeds with so many exclusive topics that hardly a node is left: the others have too little to read."""
    try:
        start, target = instance(seed, TIED, FUNCTIONALITIES)
    except ValueError:
        return None
    return change_between(initial(start), start, target)


def _solve(seed: int, seconds: float, answer: Connection) -> None:
    """Sends the result. The system ends each program of Fast Downward when its time is up."""
    from _fast_downward_problem import Encoding

    sys.path.remove(str(Path(__file__).parent))  # this file has the name of a package that the planner imports
    from unified_planning.engines import PlanGenerationResultStatus
    from unified_planning.shortcuts import OneshotPlanner, get_environment

    get_environment().credits_stream = None
    change = small(seed)
    assert change is not None
    encoding = Encoding(change)
    most = math.ceil(time.process_time() + seconds)
    resource.setrlimit(resource.RLIMIT_CPU, (most, most))
    with OneshotPlanner(name="fast-downward-opt") as planner:
        result = planner.solve(encoding.problem)
    proved = result.status == PlanGenerationResultStatus.SOLVED_OPTIMALLY
    names = [step.action.name for step in result.plan.actions] if proved else []
    found = encoding.disruption(names) if proved else None
    answer.send({"proved": proved, "seconds": seconds_of_children(), "disruption": found, "steps": len(names)})


def fast_downward(seed: int, seconds: float) -> dict[str, Any]:
    """In a separate process, whose limit on processor time the planner's own processes inherit."""
    ours, theirs = multiprocessing.Pipe(duplex=False)
    process = multiprocessing.get_context("spawn").Process(target=_solve, args=(seed, seconds, theirs))
    process.start()
    theirs.close()
    try:
        found: dict[str, Any] = ours.recv()
    except EOFError:
        found = {"proved": False, "seconds": seconds, "disruption": None, "steps": 0}
    process.join()
    if process.exitcode not in (0, -signal.SIGXCPU, -signal.SIGKILL):  # its time was not up: it has failed
        raise SystemExit(f"seed {seed}: the process that runs Fast Downward ended with status {process.exitcode}")
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="for each change and each way")
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(40)))
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "fast_downward.json")
    options = parser.parse_args()
    if find_spec("unified_planning") is None:
        print("skipped: unified-planning is not installed")
        return 0

    rows: list[dict[str, Any]] = []
    for seed in options.seeds:
        change = small(seed)
        if change is None:
            continue
        row: dict[str, Any] = {"seed": seed, "replaced": len(change.coming)}
        row["minimal"] = planned(change, options.seconds)
        row["fast_downward"] = theirs = fast_downward(seed, options.seconds)
        rows.append(row)
        ours = row["minimal"]
        if ours["proved"] and theirs["proved"]:
            assert abs(ours["disruption"] - theirs["disruption"]) < 1e-6, f"seed {seed}: {ours}, {theirs}"
        said = f"{theirs['seconds']:7.2f} s, {theirs['steps']} actions" if theirs["proved"] else "no proof"
        print(
            f"{seed:>3}  {row['replaced']} replaced  disruption {ours['disruption']:7.2f}  "
            f"minimal {ours['seconds']:.3f} s  Fast Downward {said}",
            flush=True,
        )

    by_size: dict[int, list[dict[str, Any]]] = defaultdict(list)
    for row in rows:
        by_size[row["replaced"]].append(row)
    for size, some in sorted(by_size.items()):
        words = []
        for way in ("minimal", "fast_downward"):
            times = [row[way]["seconds"] for row in some if row[way]["proved"]]
            median = f", median {statistics.median(times):.3f} s" if times else ""
            words.append(f"{way} {len(times)} of {len(some)}{median}")
        print(f"{size} replaced: {'; '.join(words)}")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps({"rows": rows}, indent=2) + "\n")
    return 0 if all(row["minimal"]["proved"] for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
