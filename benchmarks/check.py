"""What `midstride check` of large systems takes, beside what starting the interpreter costs (`python -c pass`).

The processor time of the whole command, start-up included, in interleaved runs.
"""

from __future__ import annotations

import argparse
import json
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from _guard import guard

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT))

from tests.large_systems import chain  # noqa: E402

RESULTS = ROOT / "benchmarks" / "results" / "check.json"


def processor_seconds(command: list[str]) -> float:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def by_size(sizes: list[int], runs: int) -> list[dict[str, float]]:
    """For each number of nodes, the median processor time in seconds, and as a multiple of an empty program's."""
    rows: list[dict[str, float]] = []
    with tempfile.TemporaryDirectory() as folder:
        for nodes in sizes:
            file = Path(folder) / f"{nodes}.stride"
            file.write_text(chain(nodes))
            checks, empties = [], []
            for _ in range(runs):
                checks.append(processor_seconds([sys.executable, "-m", "midstride", "check", str(file)]))
                empties.append(processor_seconds([sys.executable, "-c", "pass"]))
            seconds, empty = statistics.median(checks), statistics.median(empties)
            rows.append({"nodes": nodes, "seconds": round(seconds, 3), "times empty": round(seconds / empty, 1)})
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=7)
    parser.add_argument("--nodes", type=int, nargs="+", default=[100, 1_000, 10_000])
    parser.add_argument("--out", type=Path, default=RESULTS)
    arguments = parser.parse_args()
    guard()
    sizes = by_size(arguments.nodes, arguments.runs)
    arguments.out.parent.mkdir(exist_ok=True)
    arguments.out.write_text(json.dumps({"runs": arguments.runs, "sizes": sizes}, indent=1) + "\n")
    print(f"{'nodes':>8} {'check, processor time':>24} {'of an empty program':>22}")
    for size in sizes:
        print(f"{size['nodes']:8,.0f} {size['seconds']:22.3f} s {size['times empty']:20.1f} x")


if __name__ == "__main__":
    main()
